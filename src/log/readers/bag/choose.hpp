// SPDX-License-Identifier: Apache-2.0
// Which topics of a recording are the log: clouds of each LiDAR, and poses. Guessed from
// what is there, or named by settings.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Clouds that are read.
struct CloudChoice {
    std::vector<std::size_t> lidars;  ///< in Survey::clouds, each of a frame of its own
    std::size_t main = 0;             ///< in `lidars`: its clouds number the sweeps
    std::vector<std::string> notes;
};
/// @param wanted  names of topics; none: guessed @throws DataError where no topic has
/// clouds, UsageError for a topic that has none
CloudChoice choose_clouds(const Bag& bag, const Survey& survey, const std::vector<std::string>& wanted);

/// Poses that are used.
struct PoseChoice {
    Clock clock = Clock::stamps;
    std::int64_t zero_ns = 0;  ///< time of the first cloud, what counts as 0 s
    /// world_from_vehicle by seconds; nothing where the recording has no poses
    std::optional<PosePath> path;
    std::string world;    ///< frame in which `path` is
    std::string vehicle;  ///< frame of the vehicle: the LiDARs are fixed to it
    std::string about;    ///< what is used, in words
    std::vector<std::string> notes;
};
/// @param main  the clouds whose times need poses @param wanted  a frame, or a topic of
/// poses; empty: guessed
/// @throws UsageError where `wanted` is neither
PoseChoice choose_poses(const Bag& bag, const Survey& survey, const CloudTopic& main,
                        const std::string& wanted);

/// Boxes that are used.
struct BoxChoice {
    const BoxTopic* topic = nullptr;  ///< in Survey::boxes; null: none
    std::vector<std::string> notes;
};
/// The topic with the most boxes that have an identity, of equal ones the first by name.
BoxChoice choose_boxes(const Bag& bag, const Survey& survey);

}  // namespace relidar::bag
