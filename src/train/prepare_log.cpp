// SPDX-License-Identifier: Apache-2.0
// What is estimated from a log before a scene is trained on it: poses of the sensor, its
// beams, what moves without a label.
#include <relidar/train/train.hpp>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <system_error>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/dataset.hpp>
#include <relidar/log/registration.hpp>

#include "base/list_text.hpp"
#include "train/poses/register_options.hpp"

namespace relidar {

Sequence load_log(const Config& config, const Progress& progress, int most_scans) {
    DatasetOptions options;
    options.sequence = config.dataset.sequence;
    options.lidars = words_of(config.dataset.lidars);
    options.frames = {config.dataset.frames_begin, config.dataset.frames_end};
    options.poses_file = config.dataset.poses;
    options.skip_broken = config.dataset.skip_broken;
    options.rolling_shutter = config.sensor.rolling_shutter != RollingShutter::no;
    options.max_range_m = config.dataset.max_range_m > 0.0 ? config.dataset.max_range_m : INFINITY;
    options.min_range_m = config.dataset.min_range_m;
    options.bag.poses_from = config.dataset.poses_from;
    options.waymo.clamp_intensity = config.dataset.waymo_intensity == "clamp";
    options.progress = progress;
    options.most_scans = most_scans;
    std::error_code failed;
    const std::filesystem::path folder = std::filesystem::temp_directory_path(failed);
    limit_scan_memory(std::uint64_t(config.dataset.memory_mib) << 20, failed ? "/tmp" : folder);
    return load_sequence(config.dataset.path, options);
}

namespace {

/// Whether poses of the sensor are known before any are found from the scans.
bool has_poses(const Sequence& sequence, const Config& config) {
    return config.dataset.poses != kNoPoses && sequence.has_poses;
}

/// By how much registration moved and turned the poses of a log.
struct PoseCorrections {
    double median_m = 0.0, most_m = 0.0, median_deg = 0.0, most_deg = 0.0;

    /// @param from, to  [poses] of the log, and as registered
    PoseCorrections(const PoseTrack& from, const PoseTrack& to) {
        std::vector<double> metres, degrees;
        for (std::size_t k = 0; k < from.pose.size(); ++k) {
            const glm::dquat turn = glm::conjugate(from.pose[k].rotation) * to.pose[k].rotation;
            metres.push_back(glm::length(to.pose[k].translation - from.pose[k].translation));
            degrees.push_back(2.0 *
                              std::atan2(glm::length(glm::dvec3(turn.x, turn.y, turn.z)), std::abs(turn.w)) *
                              180.0 / kPi);
        }
        std::ranges::sort(metres);
        std::ranges::sort(degrees);
        median_m = metres[metres.size() / 2], most_m = metres.back();
        median_deg = degrees[degrees.size() / 2], most_deg = degrees.back();
    }
    std::string text() const {
        return fmt::format(
            "corrections of {:.3f} m and {:.2f} degrees (median) to {:.3f} m and {:.2f} degrees", median_m,
            median_deg, most_m, most_deg);
    }
    /// A warning if the log's poses are worse than good poses of a vehicle ever are,
    /// otherwise empty.
    std::string warning() const {
        constexpr double kLarge_m = 0.5, kLarge_deg = 5.0;
        if (most_m <= kLarge_m && most_deg <= kLarge_deg) return "";
        return fmt::format(
            "warning: the log's poses do not fit its scans: {}. Usual reasons: quaternions in x y z w order "
            "instead of w x y z, poses "
            "of another frame or without the lever arm to the LiDAR, drifting GNSS, or times that are off; "
            "dataset.poses=none does "
            "without them",
            text());
    }
};

std::string way_text(const PoseTrack& track) {
    double metres = 0.0;
    for (std::size_t k = 1; k < track.pose.size(); ++k)
        metres += glm::distance(track.pose[k].translation, track.pose[k - 1].translation);
    return fmt::format("{:.1f} m driven", metres);
}

std::string loops_text(const Registration& found) {
    if (found.places_again == 0) return "";
    return fmt::format("; {} places seen again on a later pass, up to {:.2f} m off before",
                       found.places_again, found.loops_off_m);
}

constexpr double kMostLost = 0.05;  // of the scans, one in any case

/// What is told of scans that did not find their place. @throws DataError where they are
/// too many
void tell_lost(const Sequence& sequence, const Registration& found, const Config& config,
               const PrepareSession& session) {
    if (found.lost.empty()) return;
    std::vector<int> frames;
    for (const Frame& frame : sequence.frames) {
        const bool is_lost = std::ranges::binary_search(found.lost, sequence.pose_of(frame));
        if (is_lost && (frames.empty() || frames.back() != frame.index)) frames.push_back(frame.index);
    }
    const std::size_t n = sequence.world_from_vehicle.pose.size();
    const std::string text =
        fmt::format("{} of {} scans did not find their place among the others, those of frames {}",
                    frames.size(), n, list_text(frames));
    if (double(frames.size()) > std::max(1.0, kMostLost * double(n)) && !config.train.allow_lost_scans)
        throw DataError(
            fmt::format("registering the scans of {}: {}; expected at most {:.0f} %. "
                        "train.allow_lost_scans=true moves them as their "
                        "neighbours, train.refine_poses=none keeps the log's own poses",
                        sequence.name, text, 100.0 * kMostLost));
    session.tell(text + ": moved as their neighbours were");
}

/// @return done where there are poses to be taken
Registration registered(Sequence& sequence, const Split& split, const Config& config,
                        const PrepareSession& session) {
    Registration found;
    try {
        RegisterOptions options = register_options(sequence, config);
        options.stop = session.stop;
        options.progress = session.progress;
        options.group = session.group;
        found = register_scans(sequence, split, options);
    } catch (const DataError& error) {
        if (!config.train.allow_lost_scans) throw;
        session.tell(fmt::format("{}; the log's own poses are used", error.what()));
        return {};
    }
    if (found.stopped)
        throw Error(ExitCode::interrupted, "interrupted while scans were registered: nothing is trained yet");
    if (!found.done) return found;
    const PoseCorrections corrections(sequence.world_from_vehicle, found.world_from_vehicle);
    session.tell(fmt::format(
        "scans registered: {:.0f} % of their points lie on common planes, {:.3f} m from them; {}{}",
        100.0 * found.on_planes, found.rounds.back().residual_m,
        has_poses(sequence, config) ? corrections.text() : way_text(found.world_from_vehicle),
        loops_text(found)));
    if (const std::string warning = corrections.warning(); has_poses(sequence, config) && !warning.empty()) {
        session.tell(warning);
        sequence.notes.push_back(warning);  // info shows the notes of a run
    }
    tell_lost(sequence, found, config, session);
    return found;
}

void register_sensor(Sequence& sequence, const Split& split, const Config& config,
                     const PrepareSession& session) {
    Registration found = registered(sequence, split, config, session);
    if (!found.done) found.world_from_vehicle.pose.clear();
    PoseTrack track{sequence.world_from_vehicle.time_s,
                    session.group.broadcast(std::move(found.world_from_vehicle.pose))};
    if (!track.pose.empty()) set_vehicle_poses(sequence, std::move(track));
}

void calibrate_beams(Sequence& sequence, const Split& split, const SensorConfig& config,
                     const PrepareSession& session) {
    const std::size_t n = sequence.count_beams();
    if (n > 1 && config.calibrates("range")) {
        const LaserCalibration found = calibrate_ranges(sequence, split.train);
        session.tell(
            fmt::format("ranges of {} beams compared on {:.1f} million returns: {:.1f} mm from common "
                        "planes, {:.1f} mm with an offset each{}",
                        n, double(found.returns) * 1e-6, found.rms_before * 1e3, found.rms_after * 1e3,
                        found.adopted ? "" : ": none is taken"));
    }
}

void calibrate_intensities(Sequence& sequence, const Split& split, const PrepareSession& session) {
    const IntensityCalibration found = calibrate_intensity(sequence, split.train);
    const IntensityResponse& r = sequence.intensity_response;
    const std::string fall = fmt::format("{:.2f} of it at 40 m and {:.2f} at 60 degrees of incidence",
                                         r.at_range(40.0) / r.at_range(10.0), r.at_cosine(0.5));
    session.tell(fmt::format(
        "intensities of {:.1f} million returns compared: {:.3f} apart at the same place, {:.3f} with {}",
        double(found.returns) * 1e-6, found.rms_before, found.rms_after,
        found.shared && found.beams ? "a gain and offset for each beam, " + fall
        : found.shared              ? fall
        : found.beams               ? "a gain and offset for each beam"
                                    : "what was tried: none is taken"));
}

void tell_noise(const Sequence& sequence, const PrepareSession& session) {
    for (const Lidar& lidar : sequence.lidars)
        if (!lidar.range_noise.sigma_m.empty())
            session.tell(
                fmt::format("ranges{} scatter by {:.0f} mm at 10 m and by {:.0f} mm at 40 m where surfaces "
                            "are met squarely",
                            lidar.name.empty() ? "" : " of " + lidar.name,
                            1e3 * lidar.range_noise.at(10.0, 1.0), 1e3 * lidar.range_noise.at(40.0, 1.0)));
}

/// @throws Error with exit code 130 if the user has interrupted
void stop_if_wanted(const PrepareSession& session) {
    if (session.stop && session.stop())
        throw Error(ExitCode::interrupted, "interrupted while the log was prepared: nothing is trained yet");
}

/// What the beams were found to be.
void calibrate(Sequence& sequence, const Split& split, const SensorConfig& config,
               const PrepareSession& session) {
    if (session.group.is_first()) {
        stop_if_wanted(session);
        calibrate_beams(sequence, split, config, session);
        stop_if_wanted(session);
        measure_range_noise(sequence, split.train);
        tell_noise(sequence, session);
        stop_if_wanted(session);
        if (config.calibrates("intensity")) calibrate_intensities(sequence, split, session);
    }
    const auto take_of_first = [&](auto& values) { values = session.group.broadcast(std::move(values)); };
    for (Lidar& lidar : sequence.lidars) {
        take_of_first(lidar.sensor.beams);
        take_of_first(lidar.range_noise.range_m);
        take_of_first(lidar.range_noise.cosine);
        take_of_first(lidar.range_noise.sigma_m);
    }
    take_of_first(sequence.intensity_response.range_m);
    take_of_first(sequence.intensity_response.factor);
    sequence.intensity_response.incidence =
        session.group.broadcast(std::vector{sequence.intensity_response.incidence}).front();
}

/// Its id, size and speed.
std::string described(const BoxTrack& box) {
    const PoseTrack& track = box.world_from_box;
    const double seconds = track.time_s.back() - track.time_s.front();
    return fmt::format(
        "{} {:.1f} x {:.1f} m{} at {:.1f} m/s for {:.1f} s", box.id, box.size_m.x, box.size_m.y,
        box.size_guess.empty() ? ""
                               : fmt::format(" (a guess: a {} of which one side was seen)", box.size_guess),
        glm::distance(track.pose.front().translation, track.pose.back().translation) / seconds, seconds);
}

/// A label's id and how much longer its thing was seen.
std::string continued(const BoxTrack& box) {
    std::vector<std::string> sides;
    if (box.n_before > 0) sides.push_back(fmt::format("{} frames before its labels", box.n_before));
    if (box.n_after > 0) sides.push_back(fmt::format("{} frames after them", box.n_after));
    return fmt::format("{} ({}) {}", box.id, box.category, fmt::join(sides, " and "));
}

void add_discovered(Sequence& sequence, const Split& split, const PrepareSession& session) {
    std::vector<std::string> movers, beside;
    const Progress progress = [&](std::string_view what, double done) {
        stop_if_wanted(session);
        if (session.progress) session.progress(what, done);
    };
    for (BoxTrack& box : discover_tracks(sequence, split.train, progress, session.group)) {
        if (box.n_before + box.n_after > 0) {
            beside.push_back(continued(box));
            *std::ranges::find(sequence.boxes, box.id, &BoxTrack::id) = std::move(box);
        } else {
            movers.push_back(described(box));
            sequence.boxes.push_back(std::move(box));
        }
    }
    session.tell(fmt::format("{} mover{} discovered without a label{}{}", movers.size(),
                             movers.size() == 1 ? "" : "s", movers.empty() ? "" : ": ",
                             fmt::join(movers, ", ")));
    if (!beside.empty())
        session.tell(
            fmt::format("labelled actors found beside their labels too: {}", fmt::join(beside, ", ")));
}

}  // namespace

RegisterOptions register_options(const Sequence& sequence, const Config& config) {
    RegisterOptions options;
    options.given_motion = has_poses(sequence, config);
    for (const BoxTrack& box : sequence.boxes)  // without poses nobody knows which boxes move
        if (!options.given_motion || box.moves()) options.movers.push_back(box);
    return options;
}

void prepare_log(Sequence& sequence, const Split& split, const Config& config, PrepareSession session) {
    if (!session.tell || !session.group.is_first()) session.tell = [](const std::string&) {};
    if (!has_poses(sequence, config) && !registers_sensor(config.train))
        throw UsageError(
            "the log has no poses, or dataset.poses=none: they have to be found from the scans; expected "
            "train.refine_poses=sensor");
    begin_stage(session.stages, "register");
    if (registers_sensor(config.train)) register_sensor(sequence, split, config, session);
    begin_stage(session.stages, "calibrate");
    calibrate(sequence, split, config.sensor, session);
    begin_stage(session.stages, "movers");
    if (config.init.unlabelled_movers == UnlabelledMovers::actors) add_discovered(sequence, split, session);
}

}  // namespace relidar
