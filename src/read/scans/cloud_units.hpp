// SPDX-License-Identifier: Apache-2.0
// Estimates the units of the point values in the messages of a topic, from some of its
// clouds. The messages do not contain the units.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/log.hpp>

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
    std::string time_note;    ///< text for the user about times that are not used
    std::string time_reason;  ///< why the times are read with this unit and zero
};

/// Estimates unit and reference of the point times, and which fields are read.
/// @param clouds  sample clouds of one topic
/// @param cloud_stamps_s  [clouds] time stamp of each cloud in seconds
/// @param set  what the user knows
PointCloudUnits estimate_cloud_units(const std::vector<PointTable>& clouds,
                                     const std::vector<double>& cloud_stamps_s, double cloud_interval_s,
                                     const Conventions& set = {});

/// Lists the conventions of the times of points.
/// @param lidar  empty, or the name of one of several LiDARs
void list_times(Log& log, const PointCloudUnits& units, const Conventions& set, const std::string& lidar);
/// Returns the scale that the user has set, or else `other`.
IntensityScale choose_scale(const IntensityScale& other, const Conventions& set);
/// Lists the scale of the intensities. Adds a note if it is not sure.
void list_scale(Log& log, const IntensityScale& scale, const std::string& lidar);

}  // namespace relidar::read
