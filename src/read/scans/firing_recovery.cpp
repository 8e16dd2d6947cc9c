// SPDX-License-Identifier: Apache-2.0
// Searches the start of the sweep and the time of the frame in it with LatticeFitter,
// first on a coarse grid. The elevations do not show the rotation about z. It follows
// from the azimuths, which are multiples of a tick of the head.
#include "read/scans/firing_recovery.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <fmt/format.h>
#include <Eigen/Dense>

#include <relidar/read/clouds.hpp>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "read/scans/lattice_fit.hpp"
#include "read/scans/lattice_ticks.hpp"

namespace relidar::read {
namespace {

// numbers of points of a sweep in the coarse and the fine search, and in the fit of a
// motion
constexpr std::size_t kCoarsePoints = 1000, kFinePoints = 3000, kMotionPoints = 30000;
constexpr int kSeams = 16, kReferences = 5;  // hypotheses of the coarse search
// If no hypothesis reduces the spread by this factor, the search ends.
constexpr double kPromisingRatio = 0.9;
constexpr double kFinestStep = 1.0 / 4096.0;  // of the fine search, in turns
// The search is successful if it reduces the spread at least by this factor, and if
// distant seams have a larger spread by the other factor.
constexpr double kMaxSpreadRatio = 0.75, kMinOtherSeam = 1.2;
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
    turn.reference -= share;
    return turn;
}

std::size_t count_rings(const std::vector<CompensatedSweep>& sweeps) {
    std::size_t n_rings = 0;
    for (const CompensatedSweep& sweep : sweeps)
        for (const std::uint16_t ring : sweep.points.ring) n_rings = std::max(n_rings, std::size_t(ring) + 1);
    return n_rings;
}

/// Returns the spread if the points were not moved.
double spread_without_motion(const LatticeFitter& fitter, std::size_t n_sweeps) {
    LatticeFit still{.turn = {}, .rings = {}, .motions = std::vector<SweepMotion>(n_sweeps)};
    fitter.improve(still, 6, FreeValues::cones);
    return still.spread_rad;
}

/// Fits all hypotheses of seam and reference. The head turns clockwise, because the other
/// direction with the opposite motion fits equally well.
std::vector<LatticeFit> try_turns(const LatticeFitter& fitter, std::size_t n_sweeps) {
    std::vector<LatticeFit> fits(std::size_t(kSeams * kReferences));
    parallel_for(int(fits.size()), [&](int index) {
        LatticeFit& fit = fits[std::size_t(index)];
        fit.turn = {.clockwise = true,
                    .seam_rad = kFullTurn_rad * (index % kSeams) / kSeams - kPi,
                    .reference = double(index / kSeams) / (kReferences - 1)};
        fit.motions.resize(n_sweeps);
        fitter.improve(fit, 4, FreeValues::all);
    });
    return fits;
}

/// Improves seam and reference. Tries a step of each in both directions, accepts the best
/// one, or else halves the step. The cost counts errors far above scale_rad as outliers.
void refine_turn(const LatticeFitter& fitter, LatticeFit& best) {
    // Smaller gains are noise, with which the search could go back and forth.
    constexpr double kMinGain = 1e-3;
    fitter.improve(best, 8, FreeValues::all);
    double scale_rad = 2.0 * best.spread_rad;
    for (double step = 1.0 / 64.0; step >= kFinestStep;) {
        const double best_cost = fitter.cost(best, scale_rad);
        std::array<LatticeFit, 4> neighbours;
        std::array<double, 4> costs{};
        neighbours.fill(best);
        parallel_for(4, [&](int index) {
            const double share = index % 2 == 0 ? step : -step;
            LatticeFit& fit = neighbours[std::size_t(index)];
            // fits 0 and 1 move the seam, 2 and 3 the time of the frame
            if (index < 2) fit.turn = move_seam(fit.turn, share);
            else fit.turn.reference += share;
            fitter.improve(fit, 2, FreeValues::all);
            costs[std::size_t(index)] = fitter.cost(fit, scale_rad);
        });
        const auto least = std::ranges::min_element(costs);
        if (*least < (1.0 - kMinGain) * best_cost) {
            best = neighbours[std::size_t(least - costs.begin())];
        } else {
            step *= 0.5;
            scale_rad = 2.0 * best.spread_rad;
        }
    }
    fitter.improve(best, 5, FreeValues::all);
}

/// Returns the same turn in the opposite direction of rotation. The motions are then
/// opposite, too.
HeadTurn reverse_turn(HeadTurn turn) {
    turn.clockwise = !turn.clockwise;
    turn.reference = 1.0 - turn.reference;
    return turn;
}

glm::dvec3 velocity_of(const SweepMotion& motion) {
    return {0.5 * (motion[0][0] + motion[1][0]), 0.5 * (motion[0][1] + motion[1][1]),
            0.5 * (motion[0][2] + motion[1][2])};
}

double motion_along(const std::vector<SweepMotion>& motions, const glm::dvec3& direction) {
    double sum = 0.0;
    for (const SweepMotion& motion : motions) sum += glm::dot(velocity_of(motion), direction);
    return sum;
}

/// Returns the factor k with which k * reference fits the motions best by least squares:
/// the sum over the sweeps of dot(motion, reference) / sum of dot(reference, reference).
double motion_share(const std::vector<SweepMotion>& motions, const std::vector<SweepMotion>& reference) {
    double product = 0.0, squares = 0.0;
    for (std::size_t s = 0; s < motions.size(); ++s) {
        product += glm::dot(velocity_of(motions[s]), velocity_of(reference[s]));
        squares += glm::dot(velocity_of(reference[s]), velocity_of(reference[s]));
    }
    return squares > 0.0 ? product / squares : 0.0;
}

/// Chooses the direction of rotation, and whether the poses of the log explain the
/// compensation. Returns false if the motion contradicts the poses.
bool choose_direction(FiringRecovery& recovery, const LatticeFit& best, const LatticeFitter& fitter,
                      const std::vector<CompensatedSweep>& sweeps) {
    const CompensatedSensor& sensor = recovery.sensor;
    recovery.turn = best.turn;
    recovery.rings = best.rings;
    recovery.spread_rad = best.spread_rad;
    if (!sensor.world_from_sensor) {
        const double forward = motion_along(best.motions, sensor.forward);
        if (forward < 0.0) recovery.turn = reverse_turn(best.turn);
        return std::abs(forward) > kMinForward_m * double(best.motions.size());
    }
    std::vector<SweepMotion> of_poses;
    for (const CompensatedSweep& sweep : sweeps)
        of_poses.push_back(twists_of(make_track(*sensor.world_from_sensor, sweep.time_s, sensor.period_s)));
    const double share = motion_share(best.motions, of_poses);
    if (share < 0.0) recovery.turn = reverse_turn(best.turn);
    // Inverse poses look as if the vehicle drives backward. They would reverse the turn.
    if (motion_along(of_poses, sensor.forward) < 0.0 || std::abs(share) < kMinMotion ||
        std::abs(share) > kMaxMotion)
        return false;
    LatticeFit fit{.turn = recovery.turn, .rings = {}, .motions = of_poses};
    fitter.improve(fit, 5, FreeValues::cones);
    recovery.uses_poses = fit.spread_rad <= kMaxPoseSpread * best.spread_rad;
    if (recovery.uses_poses) {
        recovery.rings = fit.rings;
        recovery.spread_rad = fit.spread_rad;
    }
    return true;
}

/// Fits the motion of the sensor in a sweep to its points. The cones show all but the
/// rotation about z, which follows from the ticks.
/// @param azimuth_rad  [points] azimuths of the points
SweepMotion fit_motion(const LidarPoints& points, const std::vector<double>& azimuth_rad,
                       const FiringRecovery& recovery) {
    const std::size_t n_rings = recovery.rings.size();
    LatticeFit fit{.turn = recovery.turn, .rings = recovery.rings, .motions = {SweepMotion{}}};
    LatticeFitter({pick_points(points, kFinePoints, n_rings)}, n_rings).improve(fit, 6, FreeValues::motions);
    const LatticeFitter fitter({pick_points(points, kMotionPoints, n_rings)}, n_rings);
    fitter.improve(fit, 2, FreeValues::motions);
    if (recovery.sensor.n_ticks == 0) return fit.motions[0];
    // The rotation changes the firing times a little, so the fit is repeated.
    std::vector<FiredPoint> fired(points.size());
    for (int pass = 0; pass < 2; ++pass) {
        for (std::size_t i = 0; i < points.size(); ++i)
            fired[i] =
                find_firing(glm::dvec3(points.position_m[i]), azimuth_rad[i], fit.motions[0], recovery.turn);
        const YawFit yaw =
            fit_yaw(fired, points.ring, recovery.turn, recovery.sensor.n_ticks, recovery.left_m);
        if (yaw.coherence < kMinCoherence) break;
        for (std::size_t half = 0; half < 2; ++half) fit.motions[0][half][5] += yaw.turned_rad[half];
        fitter.improve(fit, 2, FreeValues::motions);
    }
    return fit.motions[0];
}

/// Returns the restored points of a sweep with their places in the turn.
std::vector<FiredPoint> list_firings(const LidarPoints& restored, const HeadTurn& turn) {
    std::vector<FiredPoint> fired;
    for (const glm::vec3& p : restored.position_m)
        fired.push_back({glm::dvec3(p), turn.turn_at(azimuth_rad_of(glm::dvec3(p)))});
    return fired;
}

/// Returns the rotation about z in a turn that the poses of the log have. Logs without
/// poses have 0.
double yaw_of_poses(const CompensatedSensor& sensor, double time_s) {
    if (!sensor.world_from_sensor) return 0.0;
    const SweepMotion motion = twists_of(make_track(*sensor.world_from_sensor, time_s, sensor.period_s));
    return 0.5 * (motion[0][5] + motion[1][5]);
}

/// Returns a multiple of 128 or 100 near a number of ticks, or else the number itself.
int round_ticks(double count) {
    // A turn of 0.25 rad/s at 10 Hz changes the number of ticks by 0.4 %.
    constexpr double kMaxYaw = 0.007;
    for (const double round : {128.0, 100.0})
        if (const double near = std::round(count / round) * round;
            near > 0.0 && std::abs(near - count) < kMaxYaw * count)
            return int(near);
    return int(std::lround(count));
}

/// Returns the number of ticks in a turn, and sets the left offsets of the beams. A yaw
/// that all sweeps have cannot be separated from another number of ticks. So the function
/// uses the yaw of the poses, or prefers round numbers near the number without yaw.
/// @param restored  points of the first sweeps at their firing times, without correction
/// of the yaw
int find_ticks(const std::vector<CompensatedSweep>& sweeps, const std::vector<LidarPoints>& restored,
               FiringRecovery& recovery) {
    const CompensatedSensor& sensor = recovery.sensor;
    const auto fit_sweep_yaw = [&](std::size_t sweep, int n_ticks) {
        const LidarPoints& points = restored[sweep];
        return fit_yaw(list_firings(points, recovery.turn), points.ring, recovery.turn, n_ticks,
                       recovery.left_m);
    };
    const auto fit_left = [&](int n_ticks) {
        recovery.left_m = fit_left_offsets(restored, recovery.rings.size(), n_ticks);
    };
    if (sensor.n_ticks > 0) {
        fit_left(sensor.n_ticks);
        if (fit_sweep_yaw(0, sensor.n_ticks).coherence >= kMinCoherence) return sensor.n_ticks;
    }
    int n_ticks = 0;
    try {
        n_ticks = fit_spinning_sensor(restored, sensor.period_s).sensor.columns;
    } catch (const DataError&) {
        return 0;
    }
    fit_left(n_ticks);
    std::vector<double> counts;
    for (std::size_t s = 0; s < restored.size(); ++s) {
        const YawFit yaw = fit_sweep_yaw(s, n_ticks);
        if (yaw.coherence < kMinCoherence) continue;
        const double turned_rad =
            0.5 * (yaw.turned_rad[0] + yaw.turned_rad[1]) - yaw_of_poses(sensor, sweeps[s].time_s);
        // This rotation is due to a wrong number of ticks: if the head has N of them, the
        // phases of n_ticks drift by 2 pi (N - n_ticks) in a clockwise turn.
        const double sign = recovery.turn.clockwise ? 1.0 : -1.0;
        counts.push_back(n_ticks * (1.0 + sign * turned_rad / kFullTurn_rad));
    }
    if (counts.empty()) return 0;
    const double count = compute_median(std::move(counts));
    return sensor.world_from_sensor ? int(std::lround(count)) : round_ticks(count);
}

/// Computes the firing of a point at the seam, where the azimuth does not show whether
/// the point is at the start or at the end of the sweep. Chooses the end at which the
/// point is nearer to its cone.
template <class Motion>
FiredPoint find_seam_firing(const glm::dvec3& point_m, const Motion& motion, const HeadTurn& turn,
                            const RingCone& cone) {
    FiredPoint best = find_firing(point_m, azimuth_rad_of(point_m), motion, turn);
    double least_error = INFINITY;
    for (const double end : {-turn.reference, 1.0 - turn.reference}) {  // start and end of the sweep
        FiredPoint fired{point_m, end};
        for (int pass = 0; pass < 3; ++pass) {
            const glm::dvec3 moved_m = undo_motion(point_m, motion, fired.turn);
            const double share = turn.turn_at(azimuth_rad_of(moved_m));
            // adds -1, 0 or 1 turns: the same azimuth, near this end of the sweep
            fired.turn = share + std::round(end - share);
        }
        fired.position_m = undo_motion(point_m, motion, fired.turn);
        const bool is_inside = fired.turn >= -turn.reference && fired.turn <= 1.0 - turn.reference;
        const glm::dvec3& p = fired.position_m;
        const double error = std::abs((p.z - cone.z0_m) / axis_distance_m(p) - cone.slope);
        if (!is_inside || !(error < least_error)) continue;
        least_error = error;
        best = fired;
    }
    return best;
}

/// Sets the times of points, and moves them to their firing times with a known motion.
/// @param azimuth_rad  [points] azimuths of the points
template <class Motion>
void restore_points(LidarPoints& points, const std::vector<double>& azimuth_rad, const Motion& motion,
                    const FiringRecovery& recovery) {
    // A point within this share of the turn from the seam can be at both ends.
    constexpr double kSeamShare = 0.05;
    points.time_offset_s.resize(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3 p(points.position_m[i]);
        FiredPoint fired = find_firing(p, azimuth_rad[i], motion, recovery.turn);
        const double share = fired.turn + recovery.turn.reference;
        if (std::min(share, 1.0 - share) < kSeamShare && points.ring[i] < recovery.rings.size())
            fired = find_seam_firing(p, motion, recovery.turn, recovery.rings[points.ring[i]]);
        points.position_m[i] = glm::vec3(fired.position_m);
        points.time_offset_s[i] = float(fired.turn * recovery.sensor.period_s);
    }
}

/// Returns the share of the points at azimuths between two seams, on the shorter arc.
double share_between(const std::vector<CompensatedSweep>& sweeps, double seam_rad, double other_rad) {
    constexpr std::size_t kStride = 50;
    const double arc_rad = std::remainder(other_rad - seam_rad, kFullTurn_rad);
    std::size_t n = 0, n_between = 0;
    for (const CompensatedSweep& sweep : sweeps)
        for (std::size_t i = 0; i < sweep.points.size(); i += kStride) {
            const double azimuth_rad = azimuth_rad_of(glm::dvec3(sweep.points.position_m[i])),
                         from_seam_rad = std::remainder(azimuth_rad - seam_rad, kFullTurn_rad);
            ++n;
            if (from_seam_rad * arc_rad > 0.0 && std::abs(from_seam_rad) < std::abs(arc_rad)) ++n_between;
        }
    return n > 0 ? double(n_between) / double(n) : 0.0;
}

/// Returns the smallest spread with a clearly different seam: at least 60 degrees away,
/// and with some of the points in between.
double other_seam_spread(const std::vector<LatticeFit>& fits, const std::vector<CompensatedSweep>& sweeps,
                         double seam_rad) {
    constexpr double kFar_rad = kPi / 3.0, kMinShare = 0.1;
    double least = INFINITY;
    for (const LatticeFit& fit : fits)
        if (fit.spread_rad < least &&
            std::abs(std::remainder(fit.turn.seam_rad - seam_rad, kFullTurn_rad)) >= kFar_rad &&
            share_between(sweeps, seam_rad, fit.turn.seam_rad) >= kMinShare)
            least = fit.spread_rad;
    return least;
}

}  // namespace

std::optional<FiringRecovery> find_firings(const std::vector<CompensatedSweep>& sweeps,
                                           const CompensatedSensor& sensor) {
    const std::size_t n_rings = count_rings(sweeps);
    if (n_rings == 0 || n_rings > kMaxRecoveredRings) return std::nullopt;
    std::vector<SweepPoints> coarse, fine;
    for (const CompensatedSweep& sweep : sweeps) {
        coarse.push_back(pick_points(sweep.points, kCoarsePoints, n_rings));
        fine.push_back(pick_points(sweep.points, kFinePoints, n_rings));
    }
    const LatticeFitter coarse_fitter(std::move(coarse), n_rings), fitter(std::move(fine), n_rings);
    const double still_rad = spread_without_motion(fitter, sweeps.size());
    if (!(still_rad > kMinSpread_rad)) return std::nullopt;
    const std::vector<LatticeFit> fits = try_turns(coarse_fitter, sweeps.size());
    LatticeFit best = *std::ranges::min_element(fits, {}, &LatticeFit::spread_rad);
    if (best.spread_rad > kPromisingRatio * still_rad) return std::nullopt;
    refine_turn(fitter, best);
    FiringRecovery recovery;
    recovery.sensor = sensor;
    recovery.compensated_spread_rad = still_rad;
    recovery.other_seam_rad = other_seam_spread(fits, sweeps, best.turn.seam_rad);
    if (best.spread_rad > kMaxSpreadRatio * still_rad ||
        recovery.other_seam_rad < kMinOtherSeam * best.spread_rad ||
        !choose_direction(recovery, best, fitter, sweeps))
        return std::nullopt;
    // Restores some sweeps without the rotation about z, which find_ticks() measures.
    FiringRecovery without_yaw = recovery;
    without_yaw.uses_poses = false;
    without_yaw.sensor.n_ticks = 0;
    std::vector<LidarPoints> restored;
    const std::size_t n_restored =
        sensor.n_ticks > 0 ? std::min(kOffsetSweeps, sweeps.size()) : sweeps.size();
    for (std::size_t s = 0; s < n_restored; ++s) {
        restored.push_back(sweeps[s].points);
        restore_firings(restored.back(), without_yaw, sweeps[s].time_s);
        restored.back().time_offset_s.clear();
    }
    recovery.sensor.n_ticks = find_ticks(sweeps, restored, recovery);
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
    const std::size_t n_rings = count_rings(sweeps);
    if (sweeps.empty() || n_rings > kMaxRecoveredRings) return std::nullopt;
    const auto spread_after = [&](std::optional<double> moved_to_s) {
        std::vector<SweepPoints> picked;
        for (const CompensatedSweep& sweep : sweeps) {
            LidarPoints points = sweep.points;
            if (moved_to_s) undo_deskew_to(points, world_from_sensor, sweep.time_s, *moved_to_s);
            picked.push_back(pick_points(points, kFinePoints, n_rings));
        }
        return spread_without_motion(LatticeFitter(std::move(picked), n_rings), sweeps.size());
    };
    const double as_is_rad = spread_after(std::nullopt);
    if (!(as_is_rad > kMinSpread_rad)) return std::nullopt;
    double least_rad = kMaxSpreadRatio * as_is_rad;
    std::optional<double> best;
    for (const double moved_to_s : {0.0, compute_median(first_s), compute_median(last_s)})
        if (const double spread_rad = spread_after(moved_to_s); spread_rad < least_rad) {
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
    // Extrapolated poses do not show the motion at the start and the end of the log.
    const double start_s = frame_time_s - recovery.turn.reference * sensor.period_s;
    const bool has_poses = recovery.uses_poses && sensor.world_from_sensor->contains_time(start_s) &&
                           sensor.world_from_sensor->contains_time(start_s + sensor.period_s);
    std::vector<double> azimuth_rad;
    for (const glm::vec3& p : points.position_m) azimuth_rad.push_back(azimuth_rad_of(glm::dvec3(p)));
    if (has_poses)
        restore_points(points, azimuth_rad,
                       make_track(*sensor.world_from_sensor, frame_time_s, sensor.period_s), recovery);
    else restore_points(points, azimuth_rad, fit_motion(points, azimuth_rad, recovery), recovery);
}

void set_head_times(LidarPoints& points, const std::vector<Beam>& beams, const EncoderTickGrid& ticks,
                    const FiringRecovery& recovery) {
    points.time_offset_s.resize(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double head_rad = azimuth_facing_rad(beams[points.ring[i]], glm::dvec3(points.position_m[i])),
                     fired_rad = ticks.tick_azimuth_rad(ticks.nearest_tick(head_rad));
        points.time_offset_s[i] = float(recovery.turn.turn_at(fired_rad) * recovery.sensor.period_s);
    }
}

std::string describe_recovery(const FiringRecovery& recovery) {
    constexpr double kDegrees = 180.0 / kPi;
    return fmt::format(
        "the scans are motion-compensated; relidar moved each point back to its firing time. The head turns "
        "{}, a sweep of {:.4g} s starts at azimuth {:.1f} degrees, and {:.1f} % of it precede the time of "
        "the frame; the motion is that of the {}. The elevations of a beam then differ by {:.4f} instead "
        "of {:.4f} degrees (other starts: at least {:.4f})",
        recovery.turn.clockwise ? "clockwise" : "counter-clockwise", recovery.sensor.period_s,
        recovery.turn.seam_rad * kDegrees, 100.0 * recovery.turn.reference,
        recovery.uses_poses ? "poses" : "points", recovery.spread_rad * kDegrees,
        recovery.compensated_spread_rad * kDegrees, recovery.other_seam_rad * kDegrees);
}

}  // namespace relidar::read
