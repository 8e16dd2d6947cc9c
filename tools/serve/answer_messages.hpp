// SPDX-License-Identifier: Apache-2.0
// Scans and scenes as messages.
#pragma once

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"
#include "request_messages.hpp"

namespace relidar::serve {

/// @param config  of the run: which ranges points have
void write_scan(const RenderedScan& scan, const WantedScan& wanted, const Config& config,
                v1::LidarScan& message);
/// The same without an image.
void write_scan(const RenderedPoints& scan, const WantedScan& wanted, v1::LidarScan& message);

/// @param run  without surfels
void write_scene(const std::string& name, const Run& run, v1::Scene& message);

/// Poses of the log in the dataset's world. @param actors  names; none: all of them
/// @throws Refusal for one that is not there
void write_tracks(const Run& run, int lidar, const google::protobuf::RepeatedPtrField<std::string>& actors,
                  v1::GetTracksResponse& message);

}  // namespace relidar::serve
