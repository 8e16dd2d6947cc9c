// SPDX-License-Identifier: Apache-2.0
// Points of a simulated scan in device memory (ScanRenderer::wait_for_device_points()).
#pragma once

#include <relidar/simulate/returned_point.h>
#include <relidar/base/math.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

/// Points of a scan that stay in device memory.
struct DevicePoints {
    /// The first n_points entries are the returns, in the order of place_points().
    /// Intensities are not rounded to the steps of the log.
    Array<shared::ReturnedPoint> points;
    std::size_t n_points = 0;
    std::size_t n_rays = 0;  ///< number of rays of the scan
    Pose dataset_from_points;
    double time_s = 0.0;
};

}  // namespace relidar
