// SPDX-License-Identifier: Apache-2.0
// What is estimated from a log before a scene is trained on it.
#include <relidar/train.hpp>

#include <algorithm>
#include <iterator>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace relidar {
namespace {

/// Ids with their sizes and speeds.
std::string described(const std::vector<BoxTrack>& boxes) {
    std::vector<std::string> words;
    for (const BoxTrack& box : boxes) {
        const PoseTrack& track = box.world_from_box;
        const double path_m = glm::distance(track.pose.front().translation, track.pose.back().translation);
        words.push_back(fmt::format("{} ({:.1f} x {:.1f} m, {:.1f} m/s, {:.1f} s)", box.id, box.size_m.x, box.size_m.y, path_m / (track.time_s.back() - track.time_s.front()), track.time_s.back() - track.time_s.front()));
    }
    return fmt::format("{}", fmt::join(words, ", "));
}

}  // namespace


std::vector<std::string> prepare_log(Sequence& sequence, const Split& split, const Config& config) {
    std::vector<std::string> lines;
    const std::size_t n = sequence.sensor.beams.size();
    if (config.sensor.calibrate_range && n > 1) {
        const LaserCalibration found = calibrate_ranges(sequence, split.train);
        lines.push_back(fmt::format("ranges  of {} lasers compared on {:.1f} million returns: {:.1f} mm rms off their planes, {:.1f} mm with an offset each", n,
                                    double(found.returns) * 1e-6, found.rms_before * 1e3, found.rms_after * 1e3));
    }
    if (config.sensor.calibrate_intensity && n > 1) {
        const LaserCalibration found = calibrate_intensity(sequence, split.train);
        lines.push_back(fmt::format("intensities of {} lasers compared on {:.1f} million returns: {:.3f} rms apart, {:.3f} with a gain and offset each", n,
                                    double(found.returns) * 1e-6, found.rms_before, found.rms_after));
    }
    if (config.init.discover_actors && config.init.actors != ActorMode::background) {
        std::vector<BoxTrack> found = discover_tracks(sequence, split.train, config.init);
        lines.push_back(fmt::format("movers  {} discovered without a label{}", found.size(), found.empty() ? "" : ": " + described(found)));
        std::move(found.begin(), found.end(), std::back_inserter(sequence.boxes));
    }
    return lines;
}

}  // namespace relidar
