// SPDX-License-Identifier: Apache-2.0
// Selects which topics of a recording are loaded as a log: the clouds of each LiDAR, the
// poses and the boxes. Settings can override the automatic selection.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// The selected topics of point clouds.
struct CloudChoice {
    std::vector<std::size_t> lidars;  ///< indices in Survey::clouds, each in a different frame
    std::size_t main = 0;             ///< index in `lidars` of the LiDAR whose clouds number the sweeps
    std::vector<std::string> notes;
};
/// Selects the topics whose clouds are loaded.
/// @param wanted  names of the requested topics; empty: automatic selection
/// @throws DataError if no topic has clouds
/// @throws UsageError if a requested topic has no clouds
CloudChoice choose_clouds(const Bag& bag, const Survey& survey, const std::vector<std::string>& wanted);

/// The selected poses, and the clock of the log.
struct PoseChoice {
    Clock clock = Clock::stamps;
    std::int64_t zero_ns = 0;  ///< time of the first cloud, used as 0 s
    /// pose of the vehicle in the world frame by time in seconds; empty if the recording
    /// has no poses
    std::optional<PosePath> path;
    std::string world;    ///< frame in which `path` is expressed
    std::string vehicle;  ///< frame of the vehicle, on which the LiDARs are mounted
    std::string about;    ///< description of the selection
    std::vector<std::string> notes;
};
/// Selects the vehicle poses that are used for the log.
/// @param main  clouds at whose times poses are needed
/// @param wanted  name of a frame or of a pose topic; empty: automatic selection
/// @throws UsageError if `wanted` is neither a frame nor a pose topic
PoseChoice choose_poses(const Bag& bag, const Survey& survey, const CloudTopic& main,
                        const std::string& wanted);

/// The selected topic of boxes.
struct BoxChoice {
    const BoxTopic* topic = nullptr;  ///< a topic of Survey::boxes, or null
    std::vector<std::string> notes;
};
/// Selects the topic with the most boxes that have a track id. If several topics have the
/// same number of such boxes, selects the first topic by name.
BoxChoice choose_boxes(const Bag& bag, const Survey& survey);

}  // namespace relidar::bag
