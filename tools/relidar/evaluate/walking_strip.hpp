// SPDX-License-Identifier: Apache-2.0
// Somebody who walks, frame by frame: real above simulated.
#pragma once

#include <optional>

#include <relidar/score/report.hpp>

namespace relidar {
class Device;
struct Run;
}  // namespace relidar

namespace relidar::cli {

/// The actor with a gait that the log has the most points of, in eight successive frames,
/// from its right side.
/// @param run  whose sequence has its scans @return nothing where nobody walks, or is
/// seen so long
std::optional<ReportFigure> walking_strip(Device& device, const Run& run);

}  // namespace relidar::cli
