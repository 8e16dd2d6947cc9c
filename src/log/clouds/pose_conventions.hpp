// SPDX-License-Identifier: Apache-2.0
// Decides what the numbers of a pose file mean. Programs write the same poses with
// another order of the quaternion, in degrees, or as the inverse transform. Under the
// right reading, a vehicle drives along its x axis, and the scans agree.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/log/points.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar::folder {

/// One meaning of the numbers in a pose file.
struct PoseReading {
    std::string about;             ///< description for notes
    PoseTrack world_from_vehicle;  ///< poses according to this meaning
    /// True: the motion alone does not prove this meaning, because a vehicle that drives
    /// backwards has the same motion.
    bool needs_scans = false;
};

/// Pairs of scans with which readings are compared.
class ScanPairs {
public:
    /// Adds two scans of the same LiDAR.
    /// @param points_m  positions in the vehicle frame
    void add(double first_s, std::vector<glm::vec3> first_m, double second_s,
             std::vector<glm::vec3> second_m);
    bool empty() const { return pairs_.empty(); }
    /// Returns the share of points of each second scan that have a point of the first
    /// scan in the same cell.
    double overlap(const PoseTrack& world_from_vehicle) const;

private:
    struct Pair {
        double first_s, second_s;
        std::vector<glm::vec3> first_m, second_m;
    };
    std::vector<Pair> pairs_;
};

using ReadPairs = std::function<ScanPairs()>;

/// Returns the index of the reading that the motion of the vehicle and the scans support.
/// Returns 0, the documented reading, unless another one is clearly better. Adds a note
/// if it is not the documented reading.
/// @param readings  at least one
/// @param read_pairs  reads pairs of scans; called if the motion does not support the
/// documented reading. May be null.
/// @param where  file for the note
std::size_t choose_reading(const std::vector<PoseReading>& readings, const ReadPairs& read_pairs,
                           const std::string& where, std::vector<std::string>& notes);

}  // namespace relidar::folder
