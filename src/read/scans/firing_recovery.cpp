// SPDX-License-Identifier: Apache-2.0
#include "read/scans/firing_recovery.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include <relidar/read/clouds.hpp>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "read/scans/lattice_fit.hpp"
#include "read/scans/lattice_ticks.hpp"
#include "read/scans/robust_line.hpp"

namespace relidar::read {
namespace {

// points of a sweep in the coarse search, in the fine search, and in the fit of a motion
constexpr std::size_t kCoarsePoints = 1000, kFinePoints = 3000, kMotionPoints = 30000;
constexpr int kSeams = 16, kStarts = 5;  // hypotheses of the coarse search
// If no hypothesis reduces the spread by this factor, the search ends.
constexpr double kPromisingRatio = 0.9;
constexpr double kFinestStep_turns = 1.0 / 4096.0;  // of the fine search
// The search is successful if it reduces the spread at least by this factor, and if
// distant seams have a larger spread by the other factor.
constexpr double kMaxSpreadRatio = 0.75, kMinOtherSeam = 1.2;
// Neighbours of a turning head have a much smaller spread than their ring.
constexpr double kMaxNeighbourSpread = 0.25;
constexpr double kMaxNoise_rad = 6e-5;  // of the elevations of real LiDARs
// A smaller spread is due to rounded coordinates, and not to motion.
constexpr double kMinSpread_rad = 3e-5;
// Poses explain the compensation if their spread is at most this factor above the best.
constexpr double kMaxPoseSpread = 1.15;
// limits of the found motion relative to that of the poses. The compensation of KITTI
// odometry uses motions that are up to 1.2 times the true ones.
constexpr double kMinMotion = 0.7, kMaxMotion = 1.4;
// Without poses, the direction of rotation follows from the driving direction, so the
// vehicle must drive at least this far in a turn.
constexpr double kMinForward_m = 0.05;
// Clouds with more rings are not scans of a spinning LiDAR.
constexpr std::size_t kMaxRecoveredRings = 512;

/// Moves the seam later by a share of the turn. Keeps the head at the time of the frame.
HeadTurn move_seam(HeadTurn turn, double share) {
    turn.seam_rad =
        std::remainder(turn.seam_rad + (turn.clockwise ? -share : share) * kFullTurn_rad, kFullTurn_rad);
    turn.start_turns += share;
    return turn;
}

std::size_t count_rings(const std::vector<CompensatedSweep>& sweeps) {
    std::size_t n_rings = 0;
    for (const CompensatedSweep& sweep : sweeps)
        for (const std::uint16_t ring : sweep.points.ring) n_rings = std::max(n_rings, std::size_t(ring) + 1);
    return n_rings;
}

LatticeFitter make_fitter(const std::vector<CompensatedSweep>& sweeps, std::size_t n_points_per_sweep) {
    const std::size_t n_rings = count_rings(sweeps);
    std::vector<SweepPoints> picked;
    for (const CompensatedSweep& sweep : sweeps)
        picked.push_back(pick_points(sweep.points, n_points_per_sweep, n_rings));
    return {std::move(picked), n_rings};
}

/// Returns the spread of the points as they are.
double spread_without_motion(const LatticeFitter& fitter) {
    LatticeFit still = fitter.start_fit({});
    fitter.improve(still, 6, FreeValues::cones);
    return still.spread_rad;
}

/// Returns the robust standard deviation of the slopes of neighbours in a ring that are
/// equally far away. A turning head fires them shortly after each other, so motion
/// compensation hardly separates them. An oscillating mirror looks twice in each
/// direction, and separates them as much as other points of the ring.
double neighbour_spread(const std::vector<CompensatedSweep>& sweeps) {
    constexpr double kMaxStep_rad = 0.02, kMaxChange = 0.02;  // of azimuths, and of distances
    struct RingPoint {
        std::uint16_t ring;
        double azimuth_rad, axis_m, slope;
    };
    std::vector<double> differences;
    for (const CompensatedSweep& sweep : sweeps) {
        std::vector<RingPoint> points;
        for (std::size_t i = 0; i < sweep.points.size(); ++i) {
            const glm::dvec3 p(sweep.points.position_m[i]);
            if (!sweep.points.return_number.empty() && sweep.points.return_number[i] != 1) continue;
            if (const double axis_m = axis_distance_m(p); axis_m > 0.0)
                points.push_back({sweep.points.ring[i], azimuth_rad_of(p), axis_m, p.z / axis_m});
        }
        std::ranges::sort(points, {}, [](const RingPoint& p) { return std::pair(p.ring, p.azimuth_rad); });
        for (std::size_t i = 1; i < points.size(); ++i) {
            const RingPoint &last = points[i - 1], &point = points[i];
            if (last.ring == point.ring && point.azimuth_rad - last.azimuth_rad < kMaxStep_rad &&
                std::abs(point.axis_m - last.axis_m) < kMaxChange * point.axis_m)
                differences.push_back(std::abs(point.slope - last.slope));
        }
    }
    // Two points of equal errors differ by sqrt(2) times their standard deviation.
    return differences.empty() ? 0.0 : kMadToSigma / std::sqrt(2.0) * compute_median(std::move(differences));
}

/// Fits cones and motions for each hypothesis of the turn. The head is at one of kSeams
/// azimuths when the sweep starts, 0 to 1 turns before the time of the frame. It turns
/// clockwise, because the other direction with the opposite motion fits equally well.
std::vector<LatticeFit> try_turns(const LatticeFitter& fitter) {
    constexpr int kSteps = 4;  // Gauss-Newton steps, enough to compare the hypotheses
    std::vector<LatticeFit> fits;
    for (int start = 0; start < kStarts; ++start)
        for (int seam = 0; seam < kSeams; ++seam)
            fits.push_back(fitter.start_fit({.clockwise = true,
                                             .seam_rad = kFullTurn_rad * seam / kSeams - kPi,
                                             .start_turns = -double(start) / (kStarts - 1)}));
    parallel_for(int(fits.size()),
                 [&](int index) { fitter.improve(fits[std::size_t(index)], kSteps, FreeValues::all); });
    return fits;
}

/// Improves the turn of a fit: the azimuth of the head at the start of the sweep (seam),
/// and the time of the start. Tries a step of each in both directions, accepts the best
/// one, or else halves the step.
void refine_turn(const LatticeFitter& fitter, LatticeFit& best) {
    // Smaller gains are noise, with which the search could go back and forth.
    constexpr double kMinGain = 1e-3;
    constexpr double kFirstStep_turns = 1.0 / 64.0;
    // Gauss-Newton steps before the search, after each step of it, and after the search
    constexpr int kStepsBefore = 8, kStepsOfTrial = 2, kStepsAfter = 5;
    fitter.improve(best, kStepsBefore, FreeValues::all);
    double scale_rad = 2.0 * best.spread_rad;  // The cost counts much larger errors as outliers.
    for (double step_turns = kFirstStep_turns; step_turns >= kFinestStep_turns;) {
        const double best_cost = fitter.cost(best, scale_rad);
        std::array<LatticeFit, 4> neighbours;
        neighbours.fill(best);
        neighbours[0].turn = move_seam(best.turn, step_turns);
        neighbours[1].turn = move_seam(best.turn, -step_turns);
        neighbours[2].turn.start_turns -= step_turns;
        neighbours[3].turn.start_turns += step_turns;
        std::array<double, 4> costs{};
        parallel_for(4, [&](int index) {
            LatticeFit& fit = neighbours[std::size_t(index)];
            fitter.improve(fit, kStepsOfTrial, FreeValues::all);
            costs[std::size_t(index)] = fitter.cost(fit, scale_rad);
        });
        const auto least = std::ranges::min_element(costs);
        if (*least < (1.0 - kMinGain) * best_cost) {
            best = neighbours[std::size_t(least - costs.begin())];
        } else {
            step_turns *= 0.5;
            scale_rad = 2.0 * best.spread_rad;
        }
    }
    fitter.improve(best, kStepsAfter, FreeValues::all);
}

/// Returns the share of the points at azimuths between two seams, on the shorter arc.
double share_between(const std::vector<CompensatedSweep>& sweeps, double seam_rad, double other_rad) {
    constexpr std::size_t kStride = 50;  // Some of the points are enough.
    const double arc_rad = std::remainder(other_rad - seam_rad, kFullTurn_rad);
    std::size_t n = 0, n_between = 0;
    for (const CompensatedSweep& sweep : sweeps)
        for (std::size_t i = 0; i < sweep.points.size(); i += kStride) {
            const double azimuth_rad = azimuth_rad_of(glm::dvec3(sweep.points.position_m[i]));
            // 0 at the first seam, 1 at the other seam
            const double place = std::remainder(azimuth_rad - seam_rad, kFullTurn_rad) / arc_rad;
            ++n;
            if (place > 0.0 && place < 1.0) ++n_between;
        }
    return double(n_between) / double(n);
}

/// Returns the smallest error (spread of the elevations of a beam) of fits with a clearly
/// different seam, the azimuth at which a sweep starts. The found seam is certain only if
/// all of these fits are worse. Seams without points in between fit equally well, so they
/// are not counted as different.
double other_seam_spread(const std::vector<LatticeFit>& fits, const std::vector<CompensatedSweep>& sweeps,
                         double seam_rad) {
    constexpr double kFar_rad = kPi / 3.0, kMinShare = 0.1;
    double least_rad = INFINITY;
    for (const LatticeFit& fit : fits) {
        const double distance_rad = std::abs(std::remainder(fit.turn.seam_rad - seam_rad, kFullTurn_rad));
        if (fit.spread_rad < least_rad && distance_rad >= kFar_rad &&
            share_between(sweeps, seam_rad, fit.turn.seam_rad) >= kMinShare)
            least_rad = fit.spread_rad;
    }
    return least_rad;
}

/// Returns the turn in the opposite direction of rotation, which has opposite motions.
HeadTurn reverse_turn(HeadTurn turn) {
    turn.clockwise = !turn.clockwise;
    turn.start_turns = -turn.end_turns();
    return turn;
}

/// Returns the motion of each sweep according to the poses of the log, if it has any.
std::vector<SweepMotion> list_pose_motions(const std::vector<CompensatedSweep>& sweeps,
                                           const CompensatedSensor& sensor) {
    std::vector<SweepMotion> motions;
    if (sensor.world_from_sensor)
        for (const CompensatedSweep& sweep : sweeps)
            motions.push_back(
                twists_of(make_track(*sensor.world_from_sensor, sweep.time_s, sensor.period_s)));
    return motions;
}

/// Returns the mean translation of both halves of a sweep, in metres per turn.
glm::dvec3 velocity_of(const SweepMotion& motion) {
    return {0.5 * (motion[0][0] + motion[1][0]), 0.5 * (motion[0][1] + motion[1][1]),
            0.5 * (motion[0][2] + motion[1][2])};
}

/// Returns the sum of the translations of all sweeps along a direction.
double motion_along(const std::vector<SweepMotion>& motions, const glm::dvec3& direction) {
    double sum = 0.0;
    for (const SweepMotion& motion : motions) sum += glm::dot(velocity_of(motion), direction);
    return sum;
}

/// Returns the factor k with which k * reference fits the motions best by least squares:
/// the sum over the sweeps of dot(motion, reference) / sum of dot(reference, reference).
double motion_ratio(const std::vector<SweepMotion>& motions, const std::vector<SweepMotion>& reference) {
    double product = 0.0, squares = 0.0;
    for (std::size_t s = 0; s < motions.size(); ++s) {
        product += glm::dot(velocity_of(motions[s]), velocity_of(reference[s]));
        squares += glm::dot(velocity_of(reference[s]), velocity_of(reference[s]));
    }
    return squares > 0.0 ? product / squares : 0.0;
}

/// Chooses the direction of rotation. The fit assumes a clockwise turn. The reverse turn
/// with the opposite motion fits equally well, so it is right if the motion of the fit is
/// opposite to the true one: that of the poses, or without poses, forward.
/// @return nothing if the motion contradicts the poses, or is too short
std::optional<HeadTurn> choose_direction(const LatticeFit& fit, const CompensatedSensor& sensor,
                                         const std::vector<SweepMotion>& pose_motions) {
    if (!sensor.world_from_sensor) {
        const double forward_m = motion_along(fit.motions, sensor.forward);
        if (!(std::abs(forward_m) > kMinForward_m * double(fit.motions.size()))) return std::nullopt;
        return forward_m < 0.0 ? reverse_turn(fit.turn) : fit.turn;
    }
    // Inverse poses look as if the vehicle drives backward. They would reverse the turn.
    if (motion_along(pose_motions, sensor.forward) < 0.0) return std::nullopt;
    // near 1 if the fit moves like the poses, near -1 if it moves the opposite way
    const double ratio = motion_ratio(fit.motions, pose_motions);
    if (std::abs(ratio) < kMinMotion || std::abs(ratio) > kMaxMotion) return std::nullopt;
    return ratio < 0.0 ? reverse_turn(fit.turn) : fit.turn;
}

/// Fits the motion of the sensor in a sweep, so that the points of each beam are on its
/// cone around the z axis. A rotation about z (yaw) moves points along their cones, so it
/// follows from the azimuths, which are multiples of the angle of a tick.
SweepMotion fit_motion(const LidarPoints& points, const FiringRecovery& recovery) {
    constexpr int kSteps = 6, kMoreSteps = 2;  // Gauss-Newton steps, and those of a nearly right motion
    const std::size_t n_rings = recovery.rings.size();
    const LatticeFitter few_points({pick_points(points, kFinePoints, n_rings)}, n_rings);
    const LatticeFitter many_points({pick_points(points, kMotionPoints, n_rings)}, n_rings);
    LatticeFit fit{.turn = recovery.turn, .rings = recovery.rings, .motions = {SweepMotion{}}};
    few_points.improve(fit, kSteps, FreeValues::motions);
    many_points.improve(fit, kMoreSteps, FreeValues::motions);
    SweepMotion& motion = fit.motions[0];
    if (recovery.ticks.n == 0) return motion;  // The yaw stays unknown.
    // The yaw changes the firing times a little, so both fits are repeated.
    std::vector<double> azimuth_rad;  // [points]
    for (const glm::vec3& p : points.position_m) azimuth_rad.push_back(azimuth_rad_of(glm::dvec3(p)));
    std::vector<FiredPoint> fired(points.size());
    for (int pass = 0; pass < 2; ++pass) {
        for (std::size_t i = 0; i < points.size(); ++i)
            fired[i] = find_firing(glm::dvec3(points.position_m[i]), azimuth_rad[i], motion, recovery.turn);
        const YawFit yaw = fit_yaw(fired, points.ring, recovery.turn, recovery.ticks);
        if (yaw.coherence < kMinCoherence) break;
        motion[0][kYaw] += yaw.turned_rad[0];  // before the time of the frame
        motion[1][kYaw] += yaw.turned_rad[1];  // after it
        many_points.improve(fit, kMoreSteps, FreeValues::motions);
    }
    return motion;
}

/// Returns the remaining yaw of restored points.
YawFit fit_remaining_yaw(const LidarPoints& restored, const HeadTurn& turn, const HeadTicks& ticks) {
    std::vector<FiredPoint> fired;
    for (const glm::vec3& p : restored.position_m)
        fired.push_back({glm::dvec3(p), turn.time_turns(azimuth_rad_of(glm::dvec3(p)))});
    return fit_yaw(fired, restored.ring, turn, ticks);
}

/// Returns a usual number of ticks near a number, or else the number itself. Heads fire
/// 512, 1024, 2048 or 4096 times in a turn, or at fractions of a degree: 900, 1800, 3600.
/// Other multiples of 128 are too near to these: 896, 1792, 3584.
int round_ticks(double count) {
    // A turn of 0.25 rad/s at 10 Hz changes the number of ticks by 0.4 %.
    constexpr double kMaxYaw = 0.007;
    for (const double usual : {std::exp2(std::round(std::log2(count))), 100.0 * std::round(count / 100.0)})
        if (std::abs(usual - count) < kMaxYaw * count) return int(usual);
    return int(std::lround(count));
}

/// Estimates the number N of ticks at which the head fires in a turn. A fit gives a
/// number n near N. The phases n * azimuth then drift by 2 pi (N - n) in a clockwise
/// turn, like those of a yaw (rotation of the sensor) of 2 pi (N - n) / n. Subtracts the
/// yaw of the poses. Without poses, prefers a round number near N.
/// @param pose_motions  [sweeps] motions of the poses; empty if the log has none
/// @return no ticks if the azimuths show none
HeadTicks estimate_ticks(const std::vector<LidarPoints>& restored, const FiringRecovery& recovery,
                         const std::vector<SweepMotion>& pose_motions) {
    HeadTicks ticks;
    try {
        ticks.n = fit_spinning_sensor(restored, recovery.sensor.period_s).sensor.columns;
    } catch (const DataError&) {
        return {};
    }
    ticks.left_m = fit_left_offsets(restored, recovery.rings.size(), ticks.n);
    std::vector<double> counts;  // estimates of N from the sweeps
    for (std::size_t s = 0; s < restored.size(); ++s) {
        const YawFit yaw = fit_remaining_yaw(restored[s], recovery.turn, ticks);
        if (yaw.coherence < kMinCoherence) continue;
        // means of the yaw before and after the time of the frame
        double yaw_rad = 0.5 * (yaw.turned_rad[0] + yaw.turned_rad[1]);
        if (!pose_motions.empty()) yaw_rad -= 0.5 * (pose_motions[s][0][kYaw] + pose_motions[s][1][kYaw]);
        const double sign = recovery.turn.clockwise ? 1.0 : -1.0;
        counts.push_back(ticks.n * (1.0 + sign * yaw_rad / kFullTurn_rad));
    }
    if (counts.empty()) return {};
    const double count = compute_median(std::move(counts));
    ticks.n = pose_motions.empty() ? round_ticks(count) : int(std::lround(count));
    return ticks;
}

/// Returns the ticks at which the head fires: the known ones if the azimuths of the
/// points fit them, or else estimated ones.
HeadTicks find_ticks(const std::vector<CompensatedSweep>& sweeps, const FiringRecovery& recovery,
                     const std::vector<SweepMotion>& pose_motions) {
    const int n_known = recovery.sensor.n_ticks;
    // The elevations do not show the yaw. Restoring without poses keeps it in the
    // azimuths, where the ticks show it.
    FiringRecovery without_yaw = recovery;
    without_yaw.uses_poses = false;
    std::vector<LidarPoints> restored;
    // If the number is known, only the distances of the beams from the axis are fitted.
    const std::size_t n_restored = n_known > 0 ? std::min(kOffsetSweeps, sweeps.size()) : sweeps.size();
    for (std::size_t s = 0; s < n_restored; ++s) {
        restored.push_back(sweeps[s].points);
        restore_firings(restored.back(), without_yaw, sweeps[s].time_s);
    }
    if (n_known > 0) {
        const HeadTicks known{n_known, fit_left_offsets(restored, recovery.rings.size(), n_known)};
        if (fit_remaining_yaw(restored[0], recovery.turn, known).coherence >= kMinCoherence) return known;
    }
    return estimate_ticks(restored, recovery, pose_motions);
}

/// Finds the firing of a point near the seam, the azimuth at which a sweep starts and
/// ends. The azimuth does not show at which of both times the point was fired. So the
/// time is chosen at which the point is nearer to the cone of its beam.
/// @return nothing if both times are outside of the sweep
template <class Motion>
std::optional<FiredPoint> find_seam_firing(const glm::dvec3& point_m, const Motion& motion,
                                           const HeadTurn& turn, const RingCone& cone) {
    std::optional<FiredPoint> best;
    double least_error = INFINITY;
    for (const double end_turns : {turn.start_turns, turn.end_turns()}) {
        double fired_turns = end_turns;  // after the time of the frame, like all times here
        // The azimuth changes little with the firing time, so three passes are enough.
        for (int pass = 0; pass < 3; ++pass) {
            const glm::dvec3 moved_m = undo_motion(point_m, motion, fired_turns);
            const double time_turns = turn.time_turns(azimuth_rad_of(moved_m));
            // the time with the same azimuth that is nearest to this end
            fired_turns = time_turns + std::round(end_turns - time_turns);
        }
        const glm::dvec3 position_m = undo_motion(point_m, motion, fired_turns);
        const bool is_inside = fired_turns >= turn.start_turns && fired_turns <= turn.end_turns();
        const double error = std::abs(cone_error(position_m, cone));
        if (!is_inside || !(error < least_error)) continue;
        least_error = error;
        best = FiredPoint{position_m, fired_turns};
    }
    return best;
}

/// Sets the times of points, and moves each point to the sensor frame at its firing time,
/// which follows from its azimuth. At the seam, where a sweep starts and ends, the
/// azimuth fits both ends, so the cone of the beam decides.
/// @param motion  of the sensor: a PoseTrack or a SweepMotion, with times in turns
template <class Motion>
void restore_points(LidarPoints& points, const Motion& motion, const FiringRecovery& recovery) {
    constexpr double kNearSeam_turns = 0.05;
    const HeadTurn& turn = recovery.turn;
    points.time_offset_s.resize(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3 p(points.position_m[i]);
        FiredPoint fired = find_firing(p, azimuth_rad_of(p), motion, turn);
        const double since_start_turns = fired.time_turns - turn.start_turns;
        const bool is_near_seam = std::min(since_start_turns, 1.0 - since_start_turns) < kNearSeam_turns;
        if (is_near_seam && points.ring[i] < recovery.rings.size())
            fired = find_seam_firing(p, motion, turn, recovery.rings[points.ring[i]]).value_or(fired);
        points.position_m[i] = glm::vec3(fired.position_m);
        points.time_offset_s[i] = float(fired.time_turns * recovery.sensor.period_s);
    }
}

}  // namespace

std::optional<FiringRecovery> find_firings(const std::vector<CompensatedSweep>& sweeps,
                                           const CompensatedSensor& sensor) {
    const std::size_t n_rings = count_rings(sweeps);
    if (n_rings == 0 || n_rings > kMaxRecoveredRings) return std::nullopt;
    const LatticeFitter fitter = make_fitter(sweeps, kFinePoints);
    // Each beam draws a cone. Motion compensation moves points off the cones.
    const double still_rad = spread_without_motion(fitter);
    if (!(still_rad > kMinSpread_rad)) return std::nullopt;
    if (neighbour_spread(sweeps) > std::max(kMaxNeighbourSpread * still_rad, kMaxNoise_rad))
        return std::nullopt;

    // Finds the turn and motions that move points back to their cones.
    const std::vector<LatticeFit> fits = try_turns(make_fitter(sweeps, kCoarsePoints));
    LatticeFit best = *std::ranges::min_element(fits, {}, &LatticeFit::spread_rad);
    if (best.spread_rad > kPromisingRatio * still_rad) return std::nullopt;
    refine_turn(fitter, best);

    // The turn must explain the points clearly better than no motion and other turns.
    const double other_seam_rad = other_seam_spread(fits, sweeps, best.turn.seam_rad);
    if (best.spread_rad > kMaxSpreadRatio * still_rad || other_seam_rad < kMinOtherSeam * best.spread_rad)
        return std::nullopt;

    const std::vector<SweepMotion> pose_motions = list_pose_motions(sweeps, sensor);
    const std::optional<HeadTurn> turn = choose_direction(best, sensor, pose_motions);
    if (!turn) return std::nullopt;
    FiringRecovery recovery{.sensor = sensor, .turn = *turn, .rings = {}, .ticks = {}};
    if (sensor.world_from_sensor) {  // Exact poses are better than fitted motions.
        LatticeFit of_poses{.turn = *turn, .rings = {}, .motions = pose_motions};
        fitter.improve(of_poses, 5, FreeValues::cones);
        recovery.uses_poses = of_poses.spread_rad <= kMaxPoseSpread * best.spread_rad;
        if (recovery.uses_poses) best = std::move(of_poses);
    }
    recovery.rings = best.rings;
    recovery.spread_rad = best.spread_rad;
    recovery.compensated_spread_rad = still_rad;
    recovery.other_seam_rad = other_seam_rad;
    recovery.ticks = find_ticks(sweeps, recovery, pose_motions);
    return recovery;
}

std::optional<double> find_moved_time(const std::vector<CompensatedSweep>& sweeps,
                                      const PoseTrack& world_from_sensor) {
    std::vector<double> first_s, last_s;
    for (const CompensatedSweep& sweep : sweeps) {
        const LidarPoints& points = sweep.points;
        if (points.ring.empty() || points.time_offset_s.empty()) return std::nullopt;
        const auto [first, last] = std::ranges::minmax(points.time_offset_s);
        first_s.push_back(double(first));
        last_s.push_back(double(last));
    }
    if (sweeps.empty() || count_rings(sweeps) > kMaxRecoveredRings) return std::nullopt;
    // Points at their firing times have one elevation per ring, so their spread is small.
    const double as_is_rad = spread_without_motion(make_fitter(sweeps, kFinePoints));
    if (!(as_is_rad > kMinSpread_rad)) return std::nullopt;
    double least_rad = kMaxSpreadRatio * as_is_rad;  // A clear improvement is required.
    std::optional<double> best;
    for (const double moved_to_s : {0.0, compute_median(first_s), compute_median(last_s)}) {
        std::vector<CompensatedSweep> restored = sweeps;
        for (CompensatedSweep& sweep : restored)
            undo_deskew_to(sweep.points, world_from_sensor, sweep.time_s, moved_to_s);
        const double spread_rad = spread_without_motion(make_fitter(restored, kFinePoints));
        if (!(spread_rad < least_rad)) continue;
        least_rad = spread_rad;
        best = moved_to_s;
    }
    return best;
}

void undo_deskew_to(LidarPoints& points, const PoseTrack& world_from_sensor, double frame_time_s,
                    double moved_to_s) {
    const auto shift = [&](double by_s) {
        for (float& t_s : points.time_offset_s) t_s = float(double(t_s) + by_s);
    };
    if (moved_to_s != 0.0) shift(-moved_to_s);
    undo_deskew(points, world_from_sensor, frame_time_s + moved_to_s);
    if (moved_to_s != 0.0) shift(moved_to_s);
}

void restore_firings(LidarPoints& points, const FiringRecovery& recovery, double frame_time_s) {
    if (points.size() == 0) return;
    const CompensatedSensor& sensor = recovery.sensor;
    const double sweep_start_s = frame_time_s + recovery.turn.start_turns * sensor.period_s;
    const double sweep_end_s = sweep_start_s + sensor.period_s;
    const std::optional<PoseTrack>& poses = sensor.world_from_sensor;
    // Poses at other times would be extrapolated, so the points are better there.
    const bool has_poses =
        recovery.uses_poses && poses->contains_time(sweep_start_s) && poses->contains_time(sweep_end_s);
    if (has_poses) restore_points(points, make_track(*poses, frame_time_s, sensor.period_s), recovery);
    else restore_points(points, fit_motion(points, recovery), recovery);
}

void set_head_times(LidarPoints& points, const std::vector<Beam>& beams, const EncoderTickGrid& ticks,
                    const FiringRecovery& recovery) {
    points.time_offset_s.resize(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double head_rad = azimuth_facing_rad(beams[points.ring[i]], glm::dvec3(points.position_m[i])),
                     fired_rad = ticks.tick_azimuth_rad(ticks.nearest_tick(head_rad));
        points.time_offset_s[i] = float(recovery.turn.time_turns(fired_rad) * recovery.sensor.period_s);
    }
}

std::string describe_recovery(const FiringRecovery& recovery) {
    constexpr double kDegrees = 180.0 / kPi;
    const double share_before_frame = 0.0 - recovery.turn.start_turns;  // 0.0 -: never -0
    return fmt::format(
        "the scans are motion-compensated; relidar moved each point back to its firing time. The head turns "
        "{}, a sweep of {:.4g} s starts at azimuth {:.1f} degrees, and {:.1f} % of it precede the time of "
        "the frame; the motion is that of the {}. The elevations of a beam then differ by {:.4f} instead "
        "of {:.4f} degrees (other starts: at least {:.4f})",
        recovery.turn.clockwise ? "clockwise" : "counter-clockwise", recovery.sensor.period_s,
        recovery.turn.seam_rad * kDegrees, 100.0 * share_before_frame,
        recovery.uses_poses ? "poses" : "points", recovery.spread_rad * kDegrees,
        recovery.compensated_spread_rad * kDegrees, recovery.other_seam_rad * kDegrees);
}

}  // namespace relidar::read
