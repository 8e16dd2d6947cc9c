// SPDX-License-Identifier: Apache-2.0
// Held-out frames beside their simulated scans, as patches for a two-sample test.
#include <relidar/evaluation.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <set>

#include <fmt/format.h>

#include "core/random.hpp"
#include "evaluation/frame_sensor.hpp"
#include <relidar/error.hpp>

namespace relidar {
namespace {

// As many patches as tell an AUC to about a hundredth, and as few as are learnt in seconds.
constexpr std::size_t kPatchesOfFrame = 4000, kPatchesInAll = 32000;
constexpr const char* kLikeliest = "likeliest";
constexpr const char* kSampled = "sampled";
constexpr const char* kControl = "control";

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// A rendering as files hold its points.
RangeImage image_of_points(const RenderedScan& scan, const Config& config) {
    RangeImage image = scan.image;
    image.range_m = point_ranges(scan, config);
    return image;
}

const Frame& frame_of(const Sequence& sequence, int index, int lidar) {
    const auto it = std::find_if(sequence.frames.begin(), sequence.frames.end(),
                                 [&](const Frame& f) { return f.index == index && f.lidar == lidar; });
    if (it == sequence.frames.end()) throw DataError(fmt::format("realism: frame {} is not there, expected it as in the run", index));
    return *it;
}

/// The training frame of the same LiDAR that is nearest in time; null without one.
const Frame* nearest_training_frame(const Run& run, const ScoredFrame& frame) {
    const Frame* nearest = nullptr;
    for (const int position : run.split.train) {
        const Frame& f = run.sequence.frames[std::size_t(position)];
        if (f.lidar == frame.lidar && (!nearest || std::abs(f.time_s - frame.time_s) < std::abs(nearest->time_s - frame.time_s)))
            nearest = &f;
    }
    return nearest;
}

}  // namespace

RealismTest::RealismTest(const Run& run, const Sequence& log) : run_(run), log_(log) {
    const std::string name = run.folder.string();
    if (!run.edits.empty())
        throw DataError(fmt::format("{}: realism: found an edited run, whose log shows what was there before; expected one without edits",
                                    name));
    std::set<int> moments;
    for (const int position : run.split.test) {
        const Frame& frame = run.sequence.frames[std::size_t(position)];
        moments.insert(frame.index);
        if (run.config.sensor.grid == "native" && frame.scan.rays.rows < 2)
            throw DataError(fmt::format("{}: realism: found scans of {} rays in no order, expected images of rows and columns, of which "
                                        "patches are compared",
                                        name, frame.scan.rays.size()));
    }
    if (moments.size() < 2)
        throw DataError(fmt::format("{}: realism: found {} held-out frame{}, expected at least 2: one to learn from and one to tell", name,
                                    moments.size(), moments.size() == 1 ? "" : "s"));
    n_each_ = std::clamp<std::size_t>(kPatchesInAll / run.split.test.size(), 1, kPatchesOfFrame);
}

void RealismTest::add(ScanRenderer& renderer, const ScoredFrame& frame) {
    const auto start = Clock::now();
    const Config& config = run_.config;
    const std::uint64_t seed = hash64(std::uint64_t(frame.frame), std::uint64_t(frame.lidar));
    const auto keep = [&](const char* pair, const RangeImage& other) {
        patches_[pair][frame.frame].add(frame.real, other, n_each_, seed);
    };
    keep(kLikeliest, image_of_points(frame.rendered, config));
    const SensorChoice sensor = sensor_of_frame(config, run_.sequence, frame_of(run_.sequence, frame.frame, frame.lidar));
    keep(kSampled, image_of_points(renderer.render(sensor, frame.time_s, {}, kSampleSeed), config));
    if (const Frame* near = nearest_training_frame(run_, frame)) {
        const RangeImage control = real_image(config, frame_of(log_, near->index, near->lidar).scan);
        if (control.rows == frame.real.rows && control.columns == frame.real.columns) keep(kControl, control);
    }
    seconds_ += seconds_since(start);
}

Realism RealismTest::result(const Progress& progress) const {
    Realism realism;
    const auto start = Clock::now();
    constexpr const char* kPairs[] = {kLikeliest, kSampled, kControl};
    for (std::size_t p = 0; p < std::size(kPairs); ++p) {
        if (progress) progress("telling simulated from real", double(p) / double(std::size(kPairs)));
        std::vector<PatchPairs> moments;
        if (const auto of_pair = patches_.find(kPairs[p]); of_pair != patches_.end())
            for (const auto& [moment, patches] : of_pair->second)
                if (patches.size() > 0) moments.push_back(patches);
        if (moments.size() < 2 && kPairs[p] == kControl) continue;
        if (moments.size() < 2)
            throw DataError(fmt::format("{}: realism: {} held-out frames have pixels that return in both scans, expected at least 2",
                                        run_.folder.string(), moments.size()));
        realism.pairs.push_back({kPairs[p], two_sample_test(moments)});
        if (p > 0) continue;
        realism.n_moments = moments.size();
        for (const PatchPairs& patches : moments) realism.n_patches += patches.size();
    }
    if (progress) progress("telling simulated from real", 1.0);
    realism.seconds = seconds_ + seconds_since(start);
    return realism;
}

}  // namespace relidar
