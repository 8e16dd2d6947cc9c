// SPDX-License-Identifier: Apache-2.0
// Selects the topics of a recording that form the log: the clouds of each LiDAR, poses
// and boxes. The selection is automatic or follows settings.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Topics of point clouds that are read.
struct CloudChoice {
    std::vector<std::size_t> lidars;  ///< indices in Survey::clouds, each in a different frame
    std::size_t main = 0;             ///< index in `lidars` of the LiDAR whose clouds number the sweeps
    std::vector<std::string> notes;
};
/// Selects the cloud topics.
/// @param wanted  names of topics; empty: automatic
/// @throws DataError if no topic has clouds, UsageError if a named topic has none
CloudChoice choose_clouds(const Bag& bag, const Survey& survey, const std::vector<std::string>& wanted);

/// Poses that are used for the log.
struct PoseChoice {
    Clock clock = Clock::stamps;
    std::int64_t zero_ns = 0;  ///< time of the first cloud, used as 0 s
    /// world_from_vehicle by time in seconds; empty if the recording has no poses
    std::optional<PosePath> path;
    std::string world;    ///< frame in which `path` is expressed
    std::string vehicle;  ///< frame of the vehicle, on which the LiDARs are mounted
    std::string about;    ///< description of the selection
    std::vector<std::string> notes;
};
/// Selects the poses.
/// @param main  clouds whose times need poses
/// @param wanted  a frame, or a topic of poses; empty: automatic
/// @throws UsageError if `wanted` is neither
PoseChoice choose_poses(const Bag& bag, const Survey& survey, const CloudTopic& main,
                        const std::string& wanted);

/// Topic of boxes that is used for the log.
struct BoxChoice {
    const BoxTopic* topic = nullptr;  ///< a topic of Survey::boxes, or null
    std::vector<std::string> notes;
};
/// Selects the topic with the most boxes that have an id. Of equal topics, selects the
/// first by name.
BoxChoice choose_boxes(const Bag& bag, const Survey& survey);

}  // namespace relidar::bag
