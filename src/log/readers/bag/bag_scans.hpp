// SPDX-License-Identifier: Apache-2.0
// Reads the point clouds of a recording and converts them to the scans of the log's
// frames.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "log/clouds/cloud_units.hpp"
#include "log/clouds/folder_points.hpp"
#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// A point cloud of the bag that becomes the scan of a frame.
struct FrameCloud {
    int number = 0;        ///< number of the frame
    double time_s = 0.0;   ///< time of the frame
    double cloud_s = 0.0;  ///< time of the cloud on the clock of the log
    std::size_t lidar = 0;
    CloudEntry entry;
};

/// A topic that contains the scans of one LiDAR.
struct LidarTopic {
    const CloudTopic* clouds = nullptr;
    CloudUnits units = {};
    /// Clouds that were read to estimate units, so that they are not read again.
    std::map<Place, folder::PointTable> samples = {};
    SpinningSensor sensor = {};  ///< sensor of a topic of packets; unused for a topic of clouds
};
/// Reads a few clouds of a topic and estimates the units of their values.
/// @param step_s  time between clouds in seconds
LidarTopic sample_cloud_topic(const Bag& bag, const CloudTopic& clouds, double step_s);

/// Function that returns the pose of a LiDAR in the world frame at a time of the log.
using LidarPose = std::function<Pose(std::size_t lidar, double time_s)>;

class BagScans : public folder::ScanSource {
public:
    /// Creates a source of scans that reads a cloud only when its scan is requested.
    /// @param clouds  [frames] cloud of each frame
    /// @param deskewed_by  LiDAR poses that were used to motion-compensate the points of
    /// the bag. The source undoes this compensation
    BagScans(const Bag& bag, const std::vector<LidarTopic>& lidars, const std::vector<FrameCloud>& clouds,
             Clock clock, LidarPose deskewed_by = {})
        : bag_(bag), lidars_(lidars), clouds_(clouds), clock_(clock), deskewed_by_(std::move(deskewed_by)) {}

    std::string name(std::size_t frame) const override;
    bool has_points(std::size_t frame) const override {
        return lidars_[clouds_[frame].lidar].clouds->packets.empty();
    }
    Points points(std::size_t frame) const override;
    Scan rays(std::size_t frame) const override;

private:
    const Bag& bag_;
    const std::vector<LidarTopic>& lidars_;
    const std::vector<FrameCloud>& clouds_;
    const Clock clock_;
    const LidarPose deskewed_by_;

    folder::PointTable read_table_of_cloud(std::size_t frame, const Place& place) const;
    Points read_points_of_cloud(std::size_t frame, const CloudEntry& cloud, double cloud_s) const;
};

}  // namespace relidar::bag
