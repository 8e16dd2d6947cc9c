// SPDX-License-Identifier: Apache-2.0
// What is estimated from a log before a scene is trained on it: poses of the sensor, its lasers, what moves without a label.
#include <relidar/train.hpp>

#include <algorithm>
#include <iterator>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/error.hpp>
#include <relidar/registration.hpp>

namespace relidar {
namespace {

/// @param from, to  [poses] of the log, and as registered
std::string corrections_text(const PoseTrack& from, const PoseTrack& to) {
    std::vector<double> metres;
    for (std::size_t k = 0; k < from.pose.size(); ++k) metres.push_back(glm::length(to.pose[k].translation - from.pose[k].translation));
    std::sort(metres.begin(), metres.end());
    return fmt::format("corrections of {:.3f} m (median) to {:.3f} m", metres[metres.size() / 2], metres.back());
}

void register_sensor(Sequence& sequence, const Split& split, const Config& config, const PrepareSession& session) {
    RegisterOptions options{config.train.pose_largest_m, {}, config.init.actor_margin_m, session.stop};
    std::ranges::copy_if(sequence.boxes, std::back_inserter(options.movers), [&](const BoxTrack& box) { return box.mean_step_m() > config.init.actor_min_step_m; });
    Registration found;
    try {
        found = register_scans(sequence, split, options);
    } catch (const DataError& error) {   // nothing to go by is no reason not to train
        session.tell(fmt::format("{}; the log's own poses are used", error.what()));
        return;
    }
    if (found.stopped) throw Error(ExitCode::interrupted, "interrupted while scans were registered: nothing is trained yet");
    if (found.rounds.empty()) return;
    session.tell(fmt::format("scans registered: {:.3f} m from common planes at first, {:.3f} m now; {}", found.rounds.front().residual_m, found.rounds.back().residual_m,
                             corrections_text(sequence.world_from_sensor, found.world_from_sensor)));
    if (!found.lost.empty()) {
        std::vector<int> frames;
        for (const std::size_t k : found.lost) frames.push_back(sequence.frames[k].index);
        session.tell(fmt::format("frames {}: their scans did not find their place within {} m, their poses are corrected as those of their neighbours", fmt::join(frames, ", "), options.largest_m));
    }
    set_sensor_poses(sequence, found.world_from_sensor);
}

void calibrate_lasers(Sequence& sequence, const Split& split, const SensorConfig& config, const PrepareSession& session) {
    const std::size_t n = sequence.sensor.beams.size();
    if (n < 2) return;
    if (config.calibrate_range) {
        const LaserCalibration found = calibrate_ranges(sequence, split.train);
        session.tell(fmt::format("ranges of {} lasers compared on {:.1f} million returns: {:.1f} mm from common planes, {:.1f} mm with an offset each{}", n, double(found.returns) * 1e-6,
                                 found.rms_before * 1e3, found.rms_after * 1e3, found.adopted ? "" : ": none is taken"));
    }
    if (config.calibrate_intensity) {
        const LaserCalibration found = calibrate_intensity(sequence, split.train);
        session.tell(fmt::format("intensities of {} lasers compared on {:.1f} million returns: {:.3f} apart, {:.3f} with a gain and offset each", n, double(found.returns) * 1e-6,
                                 found.rms_before, found.rms_after));
    }
}

/// Ids with their sizes and speeds.
std::string described(const std::vector<BoxTrack>& boxes) {
    std::vector<std::string> words;
    for (const BoxTrack& box : boxes) {
        const PoseTrack& track = box.world_from_box;
        const double seconds = track.time_s.back() - track.time_s.front();
        words.push_back(fmt::format("{} {:.1f} x {:.1f} m at {:.1f} m/s for {:.1f} s", box.id, box.size_m.x, box.size_m.y, glm::distance(track.pose.front().translation, track.pose.back().translation) / seconds, seconds));
    }
    return fmt::format("{}", fmt::join(words, ", "));
}

void add_discovered(Sequence& sequence, const Split& split, const InitialiseOptions& options, const PrepareSession& session) {
    std::vector<BoxTrack> found = discover_tracks(sequence, split.train, options, session.progress);
    session.tell(fmt::format("{} movers discovered without a label{}", found.size(), found.empty() ? "" : ": " + described(found)));
    std::move(found.begin(), found.end(), std::back_inserter(sequence.boxes));
}

bool registers_sensor(const TrainConfig& config) { return config.pose_register && config.refine_poses.find("sensor") != std::string::npos; }

}  // namespace

void prepare_log(Sequence& sequence, const Split& split, const Config& config, PrepareSession session) {
    if (!session.tell) session.tell = [](const std::string&) {};
    if (registers_sensor(config.train)) register_sensor(sequence, split, config, session);
    calibrate_lasers(sequence, split, config.sensor, session);
    if (config.init.discover_actors && config.init.actors != ActorMode::background) add_discovered(sequence, split, config.init, session);
}

}  // namespace relidar
