// SPDX-License-Identifier: Apache-2.0
// Finds the meaning of the numbers in a pose file. Some programs write the quaternion in
// another order, or degrees, or the inverse transform. With the right meaning, the
// vehicle drives along its x axis, and consecutive scans overlap.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/read/points.hpp>

namespace relidar::read {

/// UsedConvention::from of values that the types of messages define.
inline constexpr const char* kFromMessages = "type of the messages";

inline constexpr const char *kScalarFirst = "qw qx qy qz", *kScalarLast = "qx qy qz qw";

/// One meaning of the numbers in a pose file.
struct PoseReading {
    std::string name;              ///< for notes, such as "qw qx qy qz"
    PoseTrack world_from_vehicle;  ///< poses according to this meaning
    /// True if this meaning is accepted only if scans overlap better. Forward motion is
    /// not enough, because vehicles can also drive backwards.
    bool needs_scans = false;
    /// Conventions of this meaning; `automatic` if the file has no quaternions or angles.
    Conventions::Quaternions quaternions = Conventions::Quaternions::automatic;
    Conventions::Angles angles = Conventions::Angles::automatic;
};

/// Pairs of scans for testing poses. With correct poses, the scans of a pair overlap.
class ScanPairs {
public:
    /// @param first_points_m, second_points_m  positions in the vehicle frame
    void add_scan_pair(double first_time_s, std::vector<glm::vec3> first_points_m, double second_time_s,
                       std::vector<glm::vec3> second_points_m);
    bool empty() const { return pairs_.empty(); }
    /// Returns the mean share of the points of a second scan that are in a grid cell with
    /// a point of the first scan.
    double overlap_fraction(const PoseTrack& world_from_vehicle) const;

private:
    struct OverlapScanPair {
        double first_s, second_s;
        std::vector<glm::vec3> first_m, second_m;
    };
    std::vector<OverlapScanPair> pairs_;
};

using ScanPairReader = std::function<ScanPairs()>;

/// Adds a convention to the table of a log, or replaces the one with this name.
void list_convention(Log& log, UsedConvention convention);
/// @throws UsageError if a convention that the user has set has no effect on this log
void check_settings_used(const Log& log, const Conventions& set);
/// Returns Conventions::clock_offset_s as a number, or nothing if it is "auto".
/// @throws UsageError for other text
std::optional<double> read_clock_offset_s(const Conventions& set);
/// Returns a clock offset for the table: "scans 37.000 s ahead of the poses".
std::string describe_clock(const std::string& scans, double offset_s);

/// Returns the index of the meaning that the user has set, or else the one that fits the
/// motion of the vehicle and the scans best: 0, the documented meaning, unless another
/// meaning is clearly better. Lists the convention in the log. Adds a note if the vehicle
/// drives backward and no scans decide.
/// @param read_scan_pairs_or_null  called only if the motion contradicts the documented
/// meaning
/// @param where  name of the file, for the note
std::size_t choose_poses(const std::vector<PoseReading>& interpretations,
                         const ScanPairReader& read_scan_pairs_or_null, const std::string& where,
                         const Conventions& set, Log& log);

/// Inverts the poses of a log, with a note, if the vehicle then drives forward and
/// consecutive scans overlap better. Also decides the order of the quaternions if the
/// reader could not. The log must contain the scans.
void fix_inverted_poses(Log& log, const Conventions& set);

}  // namespace relidar::read
