// SPDX-License-Identifier: Apache-2.0
#include "read/scans/pose_conventions.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_set>
#include <utility>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/geometry/cell_key.hpp"
#include "read/scans/stamped_log.hpp"

namespace relidar::read {
namespace {

// Minimum mean x component of the unit motion vectors in the vehicle frame.
constexpr double kMinForward = 0.9;
// Another convention is used only if it increases the mean x component, and the share of
// overlapping points, by these amounts.
constexpr double kMoreForward = 0.3, kMoreOverlap = 0.02;
constexpr std::size_t kFewestSteps = 3;
constexpr double kOverlapCell_m = 0.5;  // edge length of the cells in which the overlap of scans is counted
constexpr float kMinComparedRange_m = 3.0f,
                kMaxComparedRange_m = 40.0f;  // only points in this interval of ranges are compared

bool is_outside_overlap(const glm::vec3& point_m) {
    const float range_m = glm::length(point_m);
    return !(range_m > kMinComparedRange_m && range_m < kMaxComparedRange_m);
}

// Change of the mean upright component: maximum decrease with another convention, and
// increase that means that the vehicle was upside down.
constexpr double kLessUpright = 0.1, kMoreUpright = 0.5;
// Note that the order of the quaternions is uncertain.
constexpr const char* kQuaternionOrder = "quaternion_order";

/// Returns the mean z component of the vehicle's up axis in the world: 1 on level ground,
/// -1 upside down.
double mean_upright(const PoseTrack& track) {
    double sum = 0.0;
    for (const Pose& pose : track.pose) sum += (pose.rotation * glm::dvec3(0, 0, 1)).z;
    return sum / double(track.pose.size());
}

constexpr std::size_t kScanPairs = 5;  // number of pairs of scans that are compared

/// Returns the points of a scan in the vehicle frame.
std::vector<glm::vec3> vehicle_points(const Log& log, const Frame& frame) {
    const Pose& mounting = log.lidar_of(frame).vehicle_from_sensor;
    const RayTable& rays = frame.scan.rays;
    std::vector<glm::vec3> points_m;
    for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
        if (const float range_m = frame.scan.range_m[i]; range_m > 0.0f)
            points_m.emplace_back(mounting * glm::dvec3(rays.origin[i] + range_m * rays.direction[i]));
    return points_m;
}

/// Selects pairs of consecutive scans of the first LiDAR, evenly spread over the log.
ScanPairs collect_pairs(const Log& log) {
    std::vector<const Frame*> frames;
    for (const Frame& frame : log.frames)
        if (frame.lidar == 0 && frame.scan.count_returns() > 0) frames.push_back(&frame);
    ScanPairs pairs;
    const std::size_t n = frames.empty() ? 0 : std::min(kScanPairs, frames.size() - 1);
    for (std::size_t k = 0; k < n; ++k) {
        const std::size_t i = k * (frames.size() - 1) / n;
        pairs.add_scan_pair(frames[i]->time_s, vehicle_points(log, *frames[i]), frames[i + 1]->time_s,
                            vehicle_points(log, *frames[i + 1]));
    }
    return pairs;
}

/// Compares the meanings of the numbers in a pose file. Meaning 0 is the documented one.
/// Only the overlap of scans can choose a meaning with `needs_scans`: inverse poses.
struct PoseChoice {
    const std::vector<PoseReading>& readings;
    std::vector<double> forward;  ///< [meanings] mean x component of the vehicle's motion
    std::vector<double> upright;  ///< [meanings] result of mean_upright()
    std::size_t best = 0;         ///< meaning that is used
    std::size_t undecided = 0;    ///< meaning that may be right; 0: none

    explicit PoseChoice(const std::vector<PoseReading>& pose_readings) : readings(pose_readings) {
        for (const PoseReading& reading : readings) {
            const DrivingDirection driving = driving_direction(reading.world_from_vehicle);
            forward.push_back(driving.n_steps < kFewestSteps ? 0.0 : driving.mean.x);
            upright.push_back(mean_upright(reading.world_from_vehicle));
        }
    }

    bool is_forward(std::size_t meaning) const {
        return forward[meaning] >= kMinForward && forward[meaning] >= forward[0] + kMoreForward;
    }
    bool corrects_upside_down(std::size_t meaning) const {
        return upright[meaning] > upright[0] + kMoreUpright;
    }

    /// Returns true if the motion is plausible with a meaning, but less with meaning 0. A
    /// vehicle can also drive backward, which only the scans can show.
    bool is_possible(std::size_t meaning) const {
        if (is_forward(meaning)) return true;
        if (std::abs(forward[meaning]) < kMinForward) return false;
        const bool is_backward = forward[meaning] < 0.0 && !readings[meaning].needs_scans;
        return forward[0] < kMinForward || corrects_upside_down(meaning) || is_backward;
    }

    /// Chooses without scans: the first meaning that improves the motion and does not
    /// tilt the vehicle. A vehicle that drives backward looks like one that drives
    /// forward with another order of the quaternion. Such a meaning is only `undecided`.
    void choose_by_motion(const std::vector<std::size_t>& possible) {
        for (const std::size_t meaning : possible) {
            const bool improves_motion = is_forward(meaning) || corrects_upside_down(meaning);
            const bool becomes_tilted = upright[meaning] < upright[0] - kLessUpright;
            if (readings[meaning].needs_scans || best > 0 || becomes_tilted || !improves_motion) continue;
            const bool may_drive_backward = forward[0] <= -kMinForward || !is_forward(meaning);
            if (may_drive_backward) undecided = meaning;
            else best = meaning;
        }
    }

    /// Chooses the meaning with which scans overlap best. If the overlap does not change,
    /// a meaning with forward motion is `undecided`.
    void choose_by_overlap(const std::vector<std::size_t>& possible, const ScanPairs& scans) {
        const double first_overlap = scans.overlap_fraction(readings[0].world_from_vehicle);
        double best_overlap = first_overlap + kMoreOverlap;
        for (const std::size_t meaning : possible) {
            const double overlap = scans.overlap_fraction(readings[meaning].world_from_vehicle);
            if (overlap > best_overlap) {
                best = meaning;
                best_overlap = overlap;
            } else if (is_forward(meaning) && !readings[meaning].needs_scans &&
                       overlap >= first_overlap - kMoreOverlap) {
                undecided = meaning;
            }
        }
    }
};

/// Returns why the best meaning is used.
std::string describe_best(const PoseChoice& choice, bool has_scans) {
    const double forward = choice.forward[choice.best];
    return fmt::format(
        "guess: the vehicle then moves {:.2f} m {} per metre of its path{}, but {:.2f} m forward with {}",
        std::abs(forward), forward < 0.0 ? "backward" : "forward",
        has_scans ? " and consecutive scans overlap better" : "", choice.forward[0], choice.readings[0].name);
}

/// Returns a warning that the undecided meaning may be right.
std::string describe_doubt(const PoseChoice& choice) {
    return fmt::format(
        "the convention of the poses is uncertain: the vehicle moves {:.2f} m forward per metre of its "
        "path with poses that are read as {}, but {:.2f} m with {}; if these poses are wrong, set "
        "conventions.quaternions or conventions.angles",
        choice.forward[0], choice.readings[0].name, choice.forward[choice.undecided],
        choice.readings[choice.undecided].name);
}

/// Returns true if the user's settings allow a meaning.
bool is_allowed(const PoseReading& reading, const Conventions& set) {
    const auto fits = [](auto wanted, auto found) {
        return int(wanted) == 0 || int(found) == 0 || wanted == found;
    };
    const auto direction =
        reading.needs_scans ? Conventions::Poses::sensor_from_world : Conventions::Poses::world_from_sensor;
    return fits(set.poses, direction) && fits(set.quaternions, reading.quaternions) &&
           fits(set.angles, reading.angles);
}

/// Lists the conventions of the chosen meaning.
/// @param reason  why it was chosen
void list_reading(Log& log, const PoseReading& reading, const Conventions& set, const std::string& reason) {
    const auto list = [&](const char* name, const char* value, auto wanted, const char* key) {
        list_convention(log, {name, value, int(wanted) != 0 ? kFromSetting : reason, key});
    };
    list("poses", reading.needs_scans ? "sensor from world" : "world from sensor", set.poses,
         "conventions.poses");
    if (reading.quaternions != Conventions::Quaternions::automatic)
        list("quaternions", reading.quaternions == Conventions::Quaternions::wxyz ? "w x y z" : "x y z w",
             set.quaternions, "conventions.quaternions");
    if (reading.angles != Conventions::Angles::automatic)
        list("angles", reading.angles == Conventions::Angles::radians ? "radians" : "degrees", set.angles,
             "conventions.angles");
}

PoseTrack convert_poses(PoseTrack track, Pose (*convert)(const Pose&)) {
    for (Pose& pose : track.pose) pose = convert(pose);
    return track;
}

/// Returns a pose whose quaternion x y z w was read in the order w x y z.
Pose read_scalar_last(const Pose& pose) {
    const glm::dquat q = pose.rotation;
    return {glm::dquat(q.z, q.w, q.x, q.y), pose.translation};
}

}  // namespace

void ScanPairs::add_scan_pair(double first_time_s, std::vector<glm::vec3> first_points_m,
                              double second_time_s, std::vector<glm::vec3> second_points_m) {
    std::erase_if(first_points_m, is_outside_overlap);
    std::erase_if(second_points_m, is_outside_overlap);
    if (!first_points_m.empty() && !second_points_m.empty())
        pairs_.push_back(
            {first_time_s, second_time_s, std::move(first_points_m), std::move(second_points_m)});
}

double ScanPairs::overlap_fraction(const PoseTrack& world_from_vehicle) const {
    double sum = 0.0;
    for (const OverlapScanPair& pair : pairs_) {
        const Pose first_from_second =
            inverse(world_from_vehicle.pose_at(pair.first_s)) * world_from_vehicle.pose_at(pair.second_s);
        std::unordered_set<std::uint64_t> cells;
        for (const glm::vec3& p : pair.first_m) cells.insert(grid_key(glm::dvec3(p), kOverlapCell_m));
        const auto n_overlapping = std::ranges::count_if(pair.second_m, [&](const glm::vec3& p) {
            return cells.contains(grid_key(first_from_second * glm::dvec3(p), kOverlapCell_m));
        });
        sum += double(n_overlapping) / double(pair.second_m.size());
    }
    return pairs_.empty() ? 0.0 : sum / double(pairs_.size());
}

void list_convention(Log& log, UsedConvention convention) {
    const auto old = std::ranges::find(log.conventions_used, convention.name, &UsedConvention::name);
    if (old == log.conventions_used.end()) log.conventions_used.push_back(std::move(convention));
    else *old = std::move(convention);
}

void check_settings_used(const Log& log, const Conventions& set) {
    const auto check = [&](bool is_set, const std::string& key) {
        const auto uses = [&](const UsedConvention& used) {
            return used.setting == "conventions." + key && used.from == kFromSetting;
        };
        if (is_set && std::ranges::none_of(log.conventions_used, uses))
            fail<UsageError>(
                "the setting conventions.{} has no effect on {}: the log has no such values, or its format "
                "defines them; expected {}",
                key, log.source, key == "intensity_max" ? "0" : "auto");
    };
    check(int(set.deskew) != 0, "deskew");
    check(int(set.time_unit) != 0, "time_unit");
    check(int(set.time_zero) != 0, "time_zero");
    check(read_clock_offset_s(set).has_value(), "clock_offset_s");
    check(set.intensity_max > 0.0, "intensity_max");
    check(int(set.poses) != 0, "poses");
    check(int(set.quaternions) != 0, "quaternions");
    check(int(set.angles) != 0, "angles");
    check(int(set.rings) != 0, "rings");
    check(int(set.box_origin) != 0, "box_origin");
    check(int(set.box_axes) != 0, "box_axes");
}

std::optional<double> read_clock_offset_s(const Conventions& set) {
    if (set.clock_offset_s == "auto") return std::nullopt;
    const std::optional<double> offset_s = parse_number(set.clock_offset_s);
    constexpr double kMost_s = 4e9;  // more than the seconds since 1970
    if (!offset_s || !(std::abs(*offset_s) <= kMost_s))
        fail<UsageError>(
            "conventions.clock_offset_s: found '{}', expected auto or a number of seconds from -4e9 to 4e9",
            quote(set.clock_offset_s));
    return offset_s;
}

std::string describe_clock(const std::string& scans, double offset_s) {
    return fmt::format("{} {:.3f} s {} the poses", scans, std::abs(offset_s),
                       offset_s < 0.0 ? "behind" : "ahead of");
}

std::size_t choose_poses(const std::vector<PoseReading>& all, const ScanPairReader& read_scan_pairs_or_null,
                         const std::string& where, const Conventions& set, Log& log) {
    std::vector<PoseReading> readings;
    std::vector<std::size_t> index;  // [readings] index in `all`
    for (std::size_t k = 0; k < all.size(); ++k) {
        if (!is_allowed(all[k], set)) continue;
        readings.push_back(all[k]);
        index.push_back(k);
    }
    if (readings.empty())
        fail<UsageError>(
            "{}: the poses do not have the conventions that are set; expected conventions.poses, "
            "conventions.quaternions and conventions.angles to be auto",
            where);
    PoseChoice choice(readings);
    std::vector<std::size_t> possible;
    for (std::size_t k = 1; k < readings.size(); ++k)
        if (choice.is_possible(k)) possible.push_back(k);

    // The overlap of scans decides. Without scans, the motion of the vehicle decides.
    ScanPairs scans;
    if (!possible.empty() && read_scan_pairs_or_null) scans = read_scan_pairs_or_null();
    if (scans.empty()) choice.choose_by_motion(possible);
    else choice.choose_by_overlap(possible, scans);
    if (choice.best == 0 && choice.undecided > 0)
        log.notes.push_back(
            {readings[choice.undecided].quaternions == Conventions::Quaternions::xyzw ? kQuaternionOrder : "",
             -1, fmt::format("{}: {}", where, describe_doubt(choice))});
    list_reading(log, readings[choice.best], set,
                 choice.best > 0 ? describe_best(choice, !scans.empty()) : "default");
    return index[choice.best];
}

void fix_inverted_poses(Log& log, const Conventions& set) {
    const auto is_certain = [](const UsedConvention& used) {
        return used.name == "poses" && (used.from == kFromSetting || used.from == kFromMessages);
    };
    if (!log.has_poses || std::ranges::any_of(log.conventions_used, is_certain)) return;
    PoseTrack stored_poses = log.world_from_vehicle;  // as in the file, before centre_log()
    for (Pose& pose : stored_poses.pose) pose.translation += log.world_offset_m;
    std::vector<PoseReading> readings = {{.name = "world-from-sensor poses",  // assumed by the reader
                                          .world_from_vehicle = log.world_from_vehicle},
                                         {.name = "sensor-from-world poses",
                                          .world_from_vehicle = convert_poses(stored_poses, inverse),
                                          .needs_scans = true}};
    // If the reader could not decide the order of the quaternions, it assumed w x y z and
    // left a note. The scans now decide the order, too.
    const auto undecided = std::ranges::find(log.notes, kQuaternionOrder, &Note::id);
    const bool is_undecided = undecided != log.notes.end();
    if (is_undecided) {
        readings[0].name = kScalarFirst;
        readings[0].quaternions = Conventions::Quaternions::wxyz;
        readings.push_back({.name = kScalarLast,
                            .world_from_vehicle = convert_poses(stored_poses, read_scalar_last),
                            .quaternions = Conventions::Quaternions::xyzw});
        log.notes.erase(undecided);
    }
    Log listed;
    const std::size_t best = choose_poses(
        readings, [&] { return collect_pairs(log); }, log.source, set, listed);
    // Without their ids, the notes do not say again that the order is undecided.
    for (const Note& note : listed.notes) log.notes.push_back(note.text);
    const auto is_listed = [](const UsedConvention& used) { return used.name == "poses"; };
    if (best == 0 && !is_undecided && std::ranges::any_of(log.conventions_used, is_listed)) return;
    for (UsedConvention& used : listed.conventions_used) list_convention(log, std::move(used));
    if (best == 0) return;
    // The other readings are not centred.
    set_trajectory(log, readings[best].world_from_vehicle);
    log.world_offset_m = glm::dvec3(0.0);
    log.georeference.reset();
    centre_log(log);
}

}  // namespace relidar::read
