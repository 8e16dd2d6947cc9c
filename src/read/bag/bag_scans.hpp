// SPDX-License-Identifier: Apache-2.0
// Reads the point clouds of a recording. Converts them to the scans of the log's frames.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "read/bag/bag_file.hpp"
#include "read/bag/survey.hpp"
#include "read/scans/cloud_units.hpp"
#include "read/scans/folder_points.hpp"

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
    read::PointCloudUnits units = {};
    /// Clouds that were already read to estimate units.
    std::map<MessagePosition, read::PointTable> samples = {};
    SpinningSensor sensor = {};  ///< sensor of a topic with packets; unused for clouds
};
/// Reads a few clouds of a topic and estimates the units of their values.
/// @param cloud_period_s  time between clouds in seconds
LidarTopic estimate_units(const BagRecording& bag, const CloudTopic& cloud_topic, double cloud_period_s,
                          const Conventions& set);

/// Function that returns the pose of a LiDAR in the world frame at a time of the log.
using LidarPoseFunction = std::function<Pose(std::size_t lidar, double time_s)>;

/// Provides the scans of the frames from the messages of a recording.
class BagScans : public read::ScanProvider {
public:
    /// Creates a source of scans. It reads a cloud only when its scan is requested.
    /// @param clouds  [frames] cloud of each frame
    /// @param deskewed_by  LiDAR poses with which the points of the bag were
    /// motion-compensated. The source undoes this compensation
    BagScans(const BagRecording& bag, const std::vector<LidarTopic>& lidars,
             const std::vector<FrameCloud>& clouds, LogClock clock, LidarPoseFunction deskewed_by = {})
        : bag_(bag), lidars_(lidars), clouds_(clouds), clock_(clock), deskewed_by_(std::move(deskewed_by)) {}

    std::string frame_name(std::size_t frame_index) const override;
    bool stores_points(std::size_t frame) const override {
        return lidars_[clouds_[frame].lidar].clouds->packets.empty();
    }
    LidarPoints read_points(std::size_t frame_index) const override;
    Scan read_rays(std::size_t frame_index) const override;

private:
    const BagRecording& bag_;
    const std::vector<LidarTopic>& lidars_;
    const std::vector<FrameCloud>& clouds_;
    const LogClock clock_;
    const LidarPoseFunction deskewed_by_;

    read::PointTable read_table(std::size_t frame_index, const MessagePosition& position) const;
    LidarPoints read_cloud_points(std::size_t frame_index, const CloudEntry& cloud) const;
};

}  // namespace relidar::bag
