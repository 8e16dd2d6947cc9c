// SPDX-License-Identifier: Apache-2.0
// Estimates the units of the point values in the messages of a topic, from some of its
// clouds. The messages do not contain the units.
#pragma once

#include <string>
#include <vector>

#include "read/scans/point_meaning.hpp"

namespace relidar::read {

/// Moment at which the point times of a cloud are 0.
enum class PointTimeReference {
    none,   ///< unknown, because the points have no usable times
    stamp,  ///< offsets from the cloud's stamp
    epoch,  ///< zero of the clock that also gives the message stamps
    /// Unknown start of the sensor's clock. The first point of each cloud gets the stamp.
    sensor_clock
};

struct PointCloudUnits {
    PointTimeReference time_reference = PointTimeReference::none;
    double time_unit_s = 1.0;  ///< seconds per unit of the point times
    /// True if all points of a cloud were motion-compensated to the same time.
    bool is_deskewed = false;
    PointFieldSemantics fields;
    std::string time_note;  ///< text about the point times for the user, stored in the notes of the log
};

/// Estimates unit and reference of the point times, and which fields are read.
/// @param clouds  sample clouds of one topic
/// @param cloud_stamps_s  [clouds] time stamp of each cloud in seconds
PointCloudUnits estimate_cloud_units(const std::vector<PointTable>& clouds,
                                     const std::vector<double>& cloud_stamps_s, double cloud_interval_s);

}  // namespace relidar::read
