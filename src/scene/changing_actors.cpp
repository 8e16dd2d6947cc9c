// SPDX-License-Identifier: Apache-2.0
// Makes surfels from the points of each frame. The surfels are visible only around the
// time of their frame. This models every change of shape: steps, pedals, doors, trailers.
// Between two frames, the surfels of both frames are blended.
#include "scene/changing_actors.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

#include "base/parallel.hpp"
#include "scene/sample_index.hpp"

namespace relidar {
namespace {

// Maximum distance between points of the same surface.
constexpr double kNearPlace_m = 0.07;
// If at least this fraction of the frames has a point at a position, the position counts
// as static.
constexpr double kResting = 0.75;
// Maximum number of frames that are searched for points at a position.
constexpr std::size_t kCompared = 64;
// Minimum number of surfels per frame. Without this minimum, the actors of long logs
// would have too few surfels in each frame.
constexpr std::size_t kInFrame = 200;
// Minimum number of frames with points for an actor whose surfels change from frame to
// frame.
constexpr std::size_t kFewestChanging = 3;
// Minimum distance that the actor must walk in the log. Minimum spacing of two frames in
// walked distance, because frames of a standing actor would have a spacing of zero.
constexpr double kFewestWalked_m = 0.5, kSmallestSpacing_m = 0.02;
// Gap between the last and the first frame of a repeated motion, as a number of frame
// spacings. Because of this gap, surfels of the last frame and of the first frame are
// never visible together.
constexpr double kFramesBetween = 3.0;

/// Samples of one frame.
struct FrameSamples {
    SampleIndex index;
    double walked_m = 0.0;   ///< Mean walked distance of the samples.
    double spacing_m = 0.0;  ///< Mean difference of walked distance to the previous and the next frame.

    FrameSamples(const std::vector<Sample>& samples, std::vector<std::uint32_t> of)
        : index(samples, std::move(of)) {
        for (const std::uint32_t i : index.cloud.of)
            walked_m += double(samples[i].walked_m) / double(index.cloud.of.size());
    }
    bool has_point_at(const glm::vec3& point) const { return index.distance_m(point, 1.0) < kNearPlace_m; }
};
using Frames = std::vector<std::unique_ptr<FrameSamples>>;

Frames group_samples_by_frame(const std::vector<Sample>& samples) {
    Frames frames;
    for (auto& [frame, of_frame] : group_by_frame(samples))
        frames.push_back(std::make_unique<FrameSamples>(samples, std::move(of_frame)));
    for (std::size_t k = 0; k < frames.size(); ++k) {
        const std::size_t before = k > 0 ? k - 1 : 0, after = std::min(k + 1, frames.size() - 1);
        frames[k]->spacing_m = std::max((frames[after]->walked_m - frames[before]->walked_m) /
                                            double(std::max<std::size_t>(after - before, 1)),
                                        kSmallestSpacing_m);
    }
    return frames;
}

/// Makes one surfel for each sample, all with the same visibility.
Surfels make_surfels_at(const std::vector<Sample>& samples, const Gait& gait,
                        const InitialiseOptions& options, double incidence) {
    Surfels surfels = make_surfels_from_points(samples, options, incidence);
    surfels.add_gait();
    std::ranges::fill(surfels.gait, gait);
    return surfels;
}

}  // namespace

ChangingSurfels make_changing_surfels(const std::vector<Sample>& samples, const InitialiseOptions& options,
                                      double incidence, std::size_t max_count) {
    const Frames frames = group_samples_by_frame(samples);
    if (frames.size() < kFewestChanging) return {};
    const double recorded_m = frames.back()->walked_m - frames.front()->walked_m;
    if (recorded_m < kFewestWalked_m) return {};
    ChangingSurfels actor;
    actor.period_m = recorded_m * (1.0 + kFramesBetween / double(frames.size() - 1));
    std::vector<char> rests(samples.size());
    for_each_block(samples.size(), [&](std::size_t index) {
        const std::size_t step = frames.size() / kCompared + 1;
        std::size_t n_seen = 0, n_frames = 0;
        for (std::size_t k = 0; k < frames.size(); k += step, ++n_frames)
            n_seen += frames[k]->has_point_at(samples[index].position);
        rests[index] = double(n_seen) >= kResting * double(n_frames);
    });
    std::vector<Sample> resting;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (rests[i]) resting.push_back(samples[i]);
    if (!resting.empty())
        actor.surfels = make_surfels_at(thin_samples(resting, max_count / 2), {}, options, incidence);
    const std::size_t most_in_frame = std::max((max_count - actor.surfels.size()) / frames.size(), kInFrame);
    for (const std::unique_ptr<FrameSamples>& frame : frames) {
        std::vector<Sample> changing;
        for (const std::uint32_t i : frame->index.cloud.of)
            if (!rests[i]) changing.push_back(samples[i]);
        if (changing.empty()) continue;
        // A surfel is most visible in the phase of its frame. Its opacity falls with the
        // walked distance to this frame, as a Gaussian with the frame spacing as standard
        // deviation.
        const Gait gait{float(frame->walked_m / actor.period_m),
                        float(actor.period_m / (2.0 * kPi * frame->spacing_m)), glm::vec3(0.0f)};
        actor.surfels.append(
            make_surfels_at(thin_samples(changing, most_in_frame), gait, options, incidence));
    }
    actor.surfels = actor.surfels.reorder(compute_kd_order(actor.surfels.mean));
    return actor;
}

}  // namespace relidar
