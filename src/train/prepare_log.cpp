// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/calibration.hpp>
#include <relidar/train/train.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <relidar/log/own_body.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/registration/registration.hpp>

#include "base/fail.hpp"
#include "base/list_text.hpp"
#include "train/poses/register_options.hpp"

namespace relidar {

namespace {

/// Finds what carries each LiDAR, and removes its returns from the training frames.
void hide_carriers(Log& log, const Split& split, const LogPreparationCallbacks& session) {
    for (int l = 0; l < std::ssize(log.lidars); ++l) {
        const OwnBody body = find_own_body(log, l, split.train);
        log.lidars[std::size_t(l)].own_body = body.table;
        // A log with poses has a note about this body since it was loaded.
        const auto is_of_body = [&](const Note& n) { return n.id == "own_body" && n.lidar == l; };
        if (body.table.empty() || std::ranges::any_of(log.notes, is_of_body)) continue;
        log.notes.push_back({"own_body", l, body.describe()});
        session.report_line(body.describe());
    }
    hide_own_body(log, split.train);
}

/// Returns true if the log has poses from which the registration can start.
bool has_usable_poses(const Log& log, const Config& config) {
    return config.dataset.poses != kNoPoses && log.has_poses;
}

/// How much the registration changed the poses: median and maximum.
struct PoseCorrectionStatistics {
    double median_m = 0.0, most_m = 0.0, median_deg = 0.0, most_deg = 0.0;

    /// Computes the median and the maximum of the corrections by the registration.
    PoseCorrectionStatistics(const PoseTrack& from, const PoseTrack& to) {
        std::vector<double> metres, degrees;
        for (std::size_t k = 0; k < from.pose.size(); ++k) {
            const glm::dquat rotation_change = glm::conjugate(from.pose[k].rotation) * to.pose[k].rotation;
            metres.push_back(glm::length(to.pose[k].translation - from.pose[k].translation));
            degrees.push_back(
                2.0 *
                std::atan2(glm::length(glm::dvec3(rotation_change.x, rotation_change.y, rotation_change.z)),
                           std::abs(rotation_change.w)) *
                180.0 / kPi);
        }
        std::ranges::sort(metres);
        std::ranges::sort(degrees);
        median_m = metres[metres.size() / 2];
        most_m = metres.back();
        median_deg = degrees[degrees.size() / 2];
        most_deg = degrees.back();
    }
    std::string describe() const {
        return fmt::format(
            "poses were corrected by a median of {:.3f} m and {:.2f} degrees, and by at most {:.3f} m and "
            "{:.2f} degrees",
            median_m, median_deg, most_m, most_deg);
    }
    /// Returns a warning if the corrections are larger than the usual errors of good
    /// vehicle poses. Otherwise returns an empty text.
    std::string describe_large() const {
        constexpr double kMaxUsual_m = 0.5, kMaxUsual_deg = 5.0;
        if (most_m <= kMaxUsual_m && most_deg <= kMaxUsual_deg) return "";
        return fmt::format(
            "warning: the log's poses do not fit its scans: {}. Usual reasons: quaternions in x y z w order "
            "instead of w x y z, poses of another frame, a missing lever arm between the vehicle and the "
            "LiDAR, drifting GNSS, or wrong times. Use dataset.poses=none to estimate the poses from the "
            "scans only",
            describe());
    }
};

std::string describe_length(const PoseTrack& track) {
    double metres = 0.0;
    for (std::size_t k = 1; k < track.pose.size(); ++k)
        metres += glm::distance(track.pose[k].translation, track.pose[k - 1].translation);
    return fmt::format("{:.1f} m driven", metres);
}

/// Lists the frames whose pose has a property. Several LiDARs can have a frame with the
/// same number.
template <class Condition>
std::vector<int> list_frames(const Log& log, const Condition& has_property) {
    std::vector<int> frames;
    for (const Frame& frame : log.frames)
        if (has_property(log.find_pose_index(frame)) && (frames.empty() || frames.back() != frame.index))
            frames.push_back(frame.index);
    return frames;
}

constexpr double kMostLost = 0.05;  // share of scans that may fail to register; one may always

/// Prints which scans could not be registered.
/// @throws DataError if too many scans of a log without poses failed
void report_unregistered(const Log& log, const RegistrationResult& registration, const Config& config,
                         const LogPreparationCallbacks& session) {
    if (registration.lost.empty()) return;
    const std::vector<int> lost_frames = list_frames(
        log, [&](std::size_t pose) { return std::ranges::binary_search(registration.lost, pose); });
    const std::size_t n_scans = log.world_from_vehicle.pose.size();
    const std::string text =
        fmt::format("{} of {} scans could not be registered to their neighbours (frames {})",
                    lost_frames.size(), n_scans, list_text(lost_frames));
    if (has_usable_poses(log, config)) {
        session.report_line(text + "; they keep the poses of the log, moved like their neighbours");
        return;
    }
    const double max_lost = std::max(1.0, kMostLost * double(n_scans));
    if (double(lost_frames.size()) > max_lost && !config.train.allow_lost_scans)
        fail(
            "cannot estimate the poses of {} from its scans: {}; expected that this happens for at most "
            "{:.0f} % of the scans. Set train.allow_lost_scans=true to interpolate the poses of these scans",
            log.name, text, 100.0 * kMostLost);
    session.report_line(text + "; their poses are interpolated from their neighbours");
}

/// Names the motions along and about the axes of the vehicle (x forward, y left, z up).
constexpr std::array<const char*, 6> kMotionNames = {"forward", "sideways", "vertical",
                                                     "rolling", "pitching", "turning"};

/// Returns for each axis of the vehicle whether the scan shows less than half of a motion
/// along it, and of a rotation about it.
std::array<bool, 6> find_hidden_axes(const Pose& pose, const std::vector<UnobservedMotion>& unobserved) {
    std::array<bool, 6> is_hidden{};
    for (std::size_t i = 0; i < 6; ++i) {
        glm::dvec3 axis(0.0);
        axis[int(i % 3)] = 1.0;
        axis = pose.rotation * axis;
        Twist motion{};
        for (std::size_t k = 0; k < 3; ++k) motion[i / 3 * 3 + k] = axis[int(k)];
        const Twist shown = remove_unobserved(motion, unobserved);
        double share = 0.0;
        for (std::size_t k = 0; k < 6; ++k) share += shown[k] * motion[k];
        is_hidden[i] = share < 0.5;
    }
    return is_hidden;
}

/// Reports motions of the vehicle that the scans do not show. Warns if they are a guess
/// because the log has no poses.
void report_unobserved(Log& log, const Split& split, const Config& config,
                       const LogPreparationCallbacks& session) {
    const PoseTrack& track = log.world_from_vehicle;
    const std::vector<std::vector<UnobservedMotion>> unobserved =
        find_unobserved_motions(log, split.train, registration_options(log, config));
    std::vector<std::string> parts;
    for (std::size_t axis = 0; axis < kMotionNames.size(); ++axis) {
        const std::vector<int> frames = list_frames(log, [&](std::size_t pose) {
            return find_hidden_axes(track.pose[pose], unobserved[pose])[axis];
        });
        if (!frames.empty())
            parts.push_back(fmt::format("{} (frames {})", kMotionNames[axis], list_text(frames)));
    }
    if (parts.empty()) return;
    const std::string text =
        fmt::format("the scans do not show how the vehicle moved: {}", fmt::join(parts, ", "));
    if (has_usable_poses(log, config)) {
        session.report_line(text + "; this part of the motion is that of the log's poses");
        return;
    }
    const std::string warning = fmt::format(
        "warning: {}; this part of the motion is a guess that assumes a constant speed. Poses of wheel "
        "odometry or GNSS in dataset.poses would help",
        text);
    session.report_line(warning);
    log.notes.push_back(warning);  // the command `info` prints notes
}

/// Registers the scans of the log with each other.
/// @return nothing if the registration fails and the poses of the log may be used instead
std::optional<RegistrationResult> run_registration(const Log& log, const Split& split, const Config& config,
                                                   const LogPreparationCallbacks& session) {
    try {
        RegistrationOptions options = registration_options(log, config);
        options.stop = session.stop;
        options.progress = session.progress;
        options.group = session.group;
        return register_scans(log, split, options);
    } catch (const DataError& error) {
        if (!config.train.allow_lost_scans && !has_usable_poses(log, config)) throw;
        session.report_line(fmt::format("{}; the poses of the log are used instead", error.what()));
        return std::nullopt;
    }
}

/// Returns a text about the fit of the registered scans, and about the new poses.
/// @param poses_text describes the new poses
std::string describe_registration(const RegistrationResult& registration, const std::string& poses_text) {
    std::string loops_text;
    if (registration.n_loop_closures > 0)
        loops_text = fmt::format(
            "; {} loops were detected, where the vehicle returned to an earlier position; they corrected "
            "poses by up to {:.2f} m",
            registration.n_loop_closures, registration.largest_loop_error_m);
    return fmt::format(
        "scans registered: {:.0f} % of the points are on planes that several scans have observed, with a "
        "mean distance of {:.3f} m from these planes; {}{}",
        100.0 * registration.on_planes, registration.rounds.back().residual_m, poses_text, loops_text);
}

/// Estimates the vehicle poses by registering the scans of the log with each other, and
/// prints the result.
/// @return registration; `done` is true if it has new poses
RegistrationResult register_log(Log& log, const Split& split, const Config& config,
                                const LogPreparationCallbacks& session) {
    std::optional<RegistrationResult> result = run_registration(log, split, config, session);
    if (!result) return {};
    if (result->stopped)
        throw Error(ExitCode::interrupted,
                    "interrupted during the registration of scans, before the training started");
    if (!result->done) return std::move(*result);

    // Corrections of the log's poses are meaningful only if the log has poses.
    const bool has_poses = has_usable_poses(log, config);
    const PoseCorrectionStatistics corrections(log.world_from_vehicle, result->world_from_vehicle);
    session.report_line(describe_registration(
        *result, has_poses ? corrections.describe() : describe_length(result->world_from_vehicle)));
    const std::string warning = corrections.describe_large();
    if (has_poses && !warning.empty()) {
        session.report_line(warning);
        log.notes.push_back(warning);  // the command `info` prints notes
    }
    report_unregistered(log, *result, config, session);
    return std::move(*result);
}

/// Registers the scans and sets the new vehicle poses in the processes of the group.
/// Keeps the poses of the log if the registration has none.
void register_vehicle(Log& log, const Split& split, const Config& config,
                      const LogPreparationCallbacks& call) {
    RegistrationResult registration = register_log(log, split, config, call);
    if (!registration.done) registration.world_from_vehicle.pose.clear();
    PoseTrack track{log.world_from_vehicle.time_s,
                    call.group.broadcast(std::move(registration.world_from_vehicle.pose))};
    if (track.pose.empty()) return;
    set_trajectory(log, std::move(track));
    if (call.group.is_first()) report_unobserved(log, split, config, call);
}

/// Estimates a range offset for each beam, so that beams agree on the position of planes.
void calibrate_offsets(Log& log, const Split& split, const SensorConfig& config,
                       const LogPreparationCallbacks& session) {
    const std::size_t n_beams = log.count_beams();
    if (n_beams <= 1 || !config.calibrates("range")) return;
    const RangeCalibrationResult calibration = calibrate_ranges(log, split.train);
    session.report_line(fmt::format(
        "range calibration of {} beams ({:.1f} million returns): the mean distance of points from planes is "
        "{:.1f} mm without and {:.1f} mm with a range offset for each beam; {}",
        n_beams, double(calibration.returns) * 1e-6, calibration.rms_before * 1e3,
        calibration.rms_after * 1e3,
        calibration.adopted ? "relidar uses these range offsets"
                            : "relidar does not use these range offsets"));
}

/// Estimates how intensities depend on the beam, the range and the angle of incidence,
/// and prints how much this correction reduces the differences.
void calibrate_intensities(Log& log, const Split& split, const LogPreparationCallbacks& session) {
    const IntensityCalibrationResult calibration = calibrate_intensity(log, split.train);
    const std::string text = fmt::format(
        "intensity calibration ({:.1f} million returns): intensities of the same surface differ by {:.3f} "
        "(RMS)",
        double(calibration.returns) * 1e-6, calibration.rms_before);
    // `shared`: parameters of range and incidence. `beams`: parameters of each beam.
    if (!calibration.shared && !calibration.beams) {
        session.report_line(text +
                            "; a correction does not reduce this difference, so no correction is used");
        return;
    }
    std::vector<std::string> corrections;
    if (calibration.beams) corrections.emplace_back("the correction has one gain and offset per beam");
    if (calibration.shared) {
        const IntensityResponse& response = log.intensity_response;
        constexpr double kCosineOf60Deg = 0.5;
        corrections.push_back(fmt::format(
            "the intensity decreases to a factor of {:.2f} at 40 m and {:.2f} at an incidence angle of 60 "
            "degrees, relative to 10 m and 0 degrees",
            response.range_factor(40.0) / response.range_factor(10.0),
            response.incidence_factor(kCosineOf60Deg)));
    }
    session.report_line(fmt::format("{}, {:.3f} after the correction; {}", text, calibration.rms_after,
                                    fmt::join(corrections, "; ")));
}

/// Prints the measured noise of each LiDAR's ranges at 10 m and 40 m.
void report_range_noise(const Log& log, const LogPreparationCallbacks& session) {
    constexpr double kPerpendicular = 1.0;  // cosine of the incidence angle
    for (const Lidar& lidar : log.lidars) {
        if (lidar.range_noise.sigma_m.empty()) continue;
        session.report_line(
            fmt::format("range noise{}: {:.0f} mm at 10 m and {:.0f} mm at 40 m (standard deviation on "
                        "surfaces perpendicular to the beam)",
                        lidar.name.empty() ? "" : " of " + lidar.name,
                        1e3 * lidar.range_noise.lookup_sigma_m(10.0, kPerpendicular),
                        1e3 * lidar.range_noise.lookup_sigma_m(40.0, kPerpendicular)));
    }
}

/// @throws Error with exit code 130
void check_interrupted(const LogPreparationCallbacks& session) {
    if (session.stop && session.stop())
        throw Error(ExitCode::interrupted,
                    "interrupted during the preparation of the log, before the training started");
}

/// Calibrates ranges, noise and intensities of all LiDARs. The first process computes the
/// results and sends them. Offsets of beams come first, because they look like noise.
void calibrate_lidars(Log& log, const Split& split, const SensorConfig& config,
                      const LogPreparationCallbacks& session) {
    if (session.group.is_first()) {
        check_interrupted(session);
        calibrate_offsets(log, split, config, session);
        check_interrupted(session);
        calibrate_noise(log, split.train);
        report_range_noise(log, session);
        check_interrupted(session);
        if (config.calibrates("intensity")) calibrate_intensities(log, split, session);
    }
    // Replaces the values by those of the first process.
    const auto broadcast_from_first = [&](auto& values) {
        values = session.group.broadcast(std::move(values));
    };
    for (Lidar& lidar : log.lidars) {
        broadcast_from_first(lidar.sensor.beams);
        broadcast_from_first(lidar.range_noise.range_m);
        broadcast_from_first(lidar.range_noise.cosine);
        broadcast_from_first(lidar.range_noise.sigma_m);
    }
    broadcast_from_first(log.intensity_response.range_m);
    broadcast_from_first(log.intensity_response.factor);
    log.intensity_response.incidence =
        session.group.broadcast(std::vector{log.intensity_response.incidence}).front();
}

/// Returns a text with the id, size, mean speed and duration of a box.
std::string describe_box(const BoxTrack& box) {
    const PoseTrack& track = box.world_from_box;
    const double seconds = track.time_s.back() - track.time_s.front();
    const double speed_mps =
        glm::distance(track.pose.front().translation, track.pose.back().translation) / seconds;
    std::string size_note;
    if (!box.size_guess.empty())
        size_note = fmt::format(" estimated from the class {}, because the LiDAR observed only one side",
                                box.size_guess);
    return fmt::format("{} ({:.1f} x {:.1f} m{}, {:.1f} m/s, {:.1f} s)", box.id, box.size_m.x, box.size_m.y,
                       size_note, speed_mps, seconds);
}

/// Returns a text with the frames by which a labelled box was extended.
std::string describe_extension(const BoxTrack& box) {
    std::vector<std::string> sides;
    if (box.n_before > 0) sides.push_back(fmt::format("{} frames before the first label", box.n_before));
    if (box.n_after > 0) sides.push_back(fmt::format("{} frames after the last label", box.n_after));
    return fmt::format("{} ({}) {}", box.id, box.category, fmt::join(sides, " and "));
}

/// Returns a progress callback that also stops a long step if the user interrupts it.
Progress interruptible_progress(const LogPreparationCallbacks& session) {
    return [&session](std::string_view description, double done) {
        check_interrupted(session);
        if (session.progress) session.progress(description, done);
    };
}

/// Detects moving objects without a label, and adds their boxes to the log. Also extends
/// tracks of labelled objects to frames without a label.
void add_movers(Log& log, const Split& split, const LogPreparationCallbacks& session) {
    std::vector<std::string> movers, extended;
    for (BoxTrack& box : discover_tracks(log, split.train, interruptible_progress(session), session.group)) {
        // Only a labelled track has positions added before or after its labels.
        const bool is_labelled = box.n_before + box.n_after > 0;
        if (is_labelled) {
            extended.push_back(describe_extension(box));
            *std::ranges::find(log.boxes, box.id, &BoxTrack::id) = std::move(box);
        } else {
            movers.push_back(describe_box(box));
            log.boxes.push_back(std::move(box));
        }
    }
    session.report_line(fmt::format("detected {} moving object{} without a labelled box{}{}", movers.size(),
                                    movers.size() == 1 ? "" : "s", movers.empty() ? "" : ": ",
                                    fmt::join(movers, ", ")));
    if (!extended.empty())
        session.report_line(
            fmt::format("tracks of these labelled objects were extended to frames without a label: {}",
                        fmt::join(extended, ", ")));
}

/// Refines the poses of moving boxes by registering their points. The first process
/// computes and reports the poses, and sends them to the other processes.
void refine_boxes(Log& log, const Split& split, const LogPreparationCallbacks& session) {
    ActorRegistrationResult registration;
    if (session.group.is_first())
        registration = register_actors(log, split.train, interruptible_progress(session));
    for (BoxTrack& box : log.boxes)
        box.world_from_box.pose = session.group.broadcast(std::move(box.world_from_box.pose));
    if (registration.n_actors == 0) return;  // no moving boxes, or not the first process
    session.report_line(fmt::format(
        "{} of {} moving boxes were aligned to their points and shifted by {:.3f} m (median); {} boxes have "
        "moving labels, but their points do not move",
        registration.n_registered, registration.n_actors, registration.moved_m, registration.n_standing));
}

}  // namespace

RegistrationOptions registration_options(const Log& log, const Config& config) {
    RegistrationOptions options;
    options.use_pose_motion = has_usable_poses(log, config);
    // Treats all boxes as moving if vehicle poses are unknown, because the motion of a
    // box in the world is then also unknown.
    for (const BoxTrack& box : log.boxes)
        if (!options.use_pose_motion || box.is_moving()) options.movers.push_back(box);
    return options;
}

void prepare_log(Log& log, const Split& split, const Config& config, LogPreparationCallbacks callbacks) {
    // Only the first process of a group reports.
    if (!callbacks.report_line || !callbacks.group.is_first())
        callbacks.report_line = [](const std::string&) {};
    if (!has_usable_poses(log, config) && !registers_sensors(config.train))
        throw UsageError(
            "the log has no poses, or dataset.poses=none is set, so the poses must be estimated from the "
            "scans; use train.refine_poses=sensor");
    begin_stage(callbacks.stages, "register");
    // Without poses, the search needs the poses that the registration estimates.
    if (has_usable_poses(log, config)) hide_carriers(log, split, callbacks);
    if (registers_sensors(config.train)) register_vehicle(log, split, config, callbacks);
    if (!has_usable_poses(log, config)) hide_carriers(log, split, callbacks);
    begin_stage(callbacks.stages, "calibrate");
    calibrate_lidars(log, split, config.sensor, callbacks);
    begin_stage(callbacks.stages, "movers");
    if (config.init.unlabelled_movers == UnlabelledMoverPolicy::actors) add_movers(log, split, callbacks);
    if (registers_sensors(config.train)) refine_boxes(log, split, callbacks);
}

}  // namespace relidar
