// SPDX-License-Identifier: Apache-2.0
// Casts rays into a synthetic street after its cars were moved by edits. The resulting
// scans are exact, so the rendered scans of an edited run can be compared with them.
#pragma once

#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::cli {

/// Returns true if a run was edited and its log is a synthetic street, so that exact
/// scans of the edited street can be made.
bool is_recastable(const Run& run);

/// Replaces the scans of the held-out frames by exact scans of the edited street, without
/// noise.
/// @return exact scans of the street before the edits, one per held-out frame
/// @throws DataError if the model of an actor is not a car of the street
std::vector<Scan> attach_recast(Run& run);

/// Returns the pixels that an edit changes. These are the pixels whose exact range before
/// the edit differs from their exact range after it. The metrics of these pixels are
/// named edited/*.
Region edited_region(const RangeImage& edited, const RangeImage& before);

}  // namespace relidar::cli
