// SPDX-License-Identifier: Apache-2.0
// Makes surfels from the points of each frame. They are visible only around the time of
// their frame, and move with the points of the neighbouring frames. This models every
// change of shape: steps, pedals, doors, trailers.
#include "scene/changing_actors.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include "base/median.hpp"
#include "base/parallel.hpp"
#include "scene/sample_index.hpp"

namespace relidar {
namespace {

// maximum distance between points of the same surface
constexpr double kSameSurface_m = 0.07;
// minimum share of the frames that have a point at a static position
constexpr double kResting = 0.75;
// maximum number of frames that are searched for this share
constexpr std::size_t kCompared = 64;
// Minimum number of surfels of a frame, because an equal share can be too small.
constexpr std::size_t kInFrame = 200;
// An actor in fewer frames, or that walks less, is modelled as rigid.
constexpr std::size_t kFewestChanging = 3;
// kSmallestSpacing_m is a lower limit for the distance that it walks per frame.
constexpr double kFewestWalked_m = 0.5, kSmallestSpacing_m = 0.02;
// An actor repeats its recorded walk in a loop. Ratio (distance walked from the last
// frame to the repeated first frame) / (mean distance walked per frame). A low ratio
// would show both frames simultaneously.
constexpr double kFramesBetween = 3.0;

/// Samples of one frame.
struct FrameSamples {
    SampleIndex index;
    double walked_m = 0.0;   ///< Mean walked distance of the samples.
    double spacing_m = 0.0;  ///< Mean difference of walked distance to the previous and the next frame.

    FrameSamples(const std::vector<LidarSample>& samples, std::vector<std::uint32_t> sample_indices)
        : index(samples, std::move(sample_indices)) {
        for (const std::uint32_t i : index.cloud.of)
            walked_m += double(samples[i].walked_m) / double(index.cloud.of.size());
    }
};
using SamplesByFrame = std::vector<std::unique_ptr<FrameSamples>>;

SamplesByFrame group_samples_by_frame(const std::vector<LidarSample>& samples) {
    SamplesByFrame frames;
    for (auto& [frame, of_frame] : group_sample_indices_by_frame(samples))
        frames.push_back(std::make_unique<FrameSamples>(samples, std::move(of_frame)));
    for (std::size_t k = 0; k < frames.size(); ++k) {
        const std::size_t before = k > 0 ? k - 1 : 0, after = std::min(k + 1, frames.size() - 1);
        frames[k]->spacing_m = std::max((frames[after]->walked_m - frames[before]->walked_m) /
                                            double(std::max<std::size_t>(after - before, 1)),
                                        kSmallestSpacing_m);
    }
    return frames;
}

/// Estimates how the surface around a sample moves, in metres per frame: the shift that
/// moves the points around the sample onto those of two earlier and two later frames.
glm::vec3 estimate_surface_shift_per_frame(const SamplesByFrame& frames, std::size_t frame_index,
                                           const std::vector<LidarSample>& samples,
                                           const LidarSample& sample) {
    constexpr float kFarthest_m = 0.3f, kHighest_m = 0.08f, kStep_m = 0.04f;
    constexpr double kPatch_m = 0.12, kFar_m = 0.15;
    constexpr std::size_t kOfPatch = 6;
    const FrameSamples& here = *frames[frame_index];
    const std::vector<std::uint32_t> patch =
        here.index.find_samples_within_radius(sample.position, kPatch_m, kOfPatch);
    glm::vec3 best(0.0f);
    double least = std::numeric_limits<double>::infinity();
    for (float x = -kFarthest_m; x < kFarthest_m + 0.5f * kStep_m; x += kStep_m)
        for (float z = -kHighest_m; z < kHighest_m + 0.5f * kStep_m; z += kStep_m) {
            const glm::vec3 shift(x, 0.0f, z);
            // A small cost selects the smallest of several equally good shifts.
            double sum = 1e-3 * double(glm::length(shift));
            for (std::size_t f = frame_index - std::min<std::size_t>(frame_index, 2);
                 f < std::min(frame_index + 3, frames.size()); ++f) {
                const auto n_frames = float((frames[f]->walked_m - here.walked_m) / here.spacing_m);
                if (f == frame_index || std::abs(n_frames) > 3.0f) continue;
                for (const std::uint32_t i : patch)
                    sum += frames[f]->index.compute_nearest_distance_m(samples[i].position + n_frames * shift,
                                                                       kFar_m);
            }
            if (sum < least) {
                least = sum;
                best = shift;
            }
        }
    return best;
}

/// Replaces each shift by the median of the shifts at the nearest samples, per axis.
std::vector<glm::vec3> smooth_shifts_by_median(const std::vector<LidarSample>& samples,
                                               const std::vector<glm::vec3>& shifts) {
    constexpr double kAround_m = 0.15;
    constexpr std::size_t kMost = 9;
    std::vector<std::uint32_t> all(samples.size());
    std::iota(all.begin(), all.end(), 0u);
    const SampleIndex index(samples, all);
    std::vector<glm::vec3> medians(shifts);
    for (std::size_t i = 0; i < samples.size(); ++i)
        for (int axis = 0; axis < 3; ++axis) {
            std::vector<float> values;
            for (const std::uint32_t j :
                 index.find_samples_within_radius(samples[i].position, kAround_m, kMost))
                values.push_back(shifts[j][axis]);
            if (!values.empty()) medians[i][axis] = compute_median(std::move(values));
        }
    return medians;
}

/// Makes one surfel for each sample, with the gait of the sample.
Surfels make_surfels_with_gait(const std::vector<LidarSample>& samples,
                               const std::vector<GaitPhaseWindow>& gaits,
                               const SceneInitialisationOptions& options, double incidence_coefficient) {
    std::vector<std::uint32_t> order;
    Surfels surfels = make_surfels_from_points(samples, options, incidence_coefficient, {}, &order);
    surfels.add_motionless_gait();
    for (std::size_t i = 0; i < order.size(); ++i) surfels.gait[i] = gaits[order[i]];
    return surfels;
}

/// Returns true for each sample near which most frames have a point.
std::vector<char> mark_static_samples(const std::vector<LidarSample>& samples, const SamplesByFrame& frames) {
    std::vector<char> is_static(samples.size());
    const std::size_t step = frames.size() / kCompared + 1;
    parallel_for_in_blocks(samples.size(), [&](std::size_t index) {
        std::size_t n_frames_with_point = 0, n_frames = 0;
        for (std::size_t k = 0; k < frames.size(); k += step, ++n_frames)
            n_frames_with_point +=
                frames[k]->index.compute_nearest_distance_m(samples[index].position, 1.0) < kSameSurface_m;
        is_static[index] = double(n_frames_with_point) >= kResting * double(n_frames);
    });
    return is_static;
}

/// Makes surfels with the shape of an actor in one frame. Their opacity is a Gaussian of
/// the walked distance with the standard deviation `FrameSamples::spacing_m`.
/// @param changing_samples samples of this frame where the shape of the actor changes
Surfels make_actor_surfels_of_frame(const SamplesByFrame& samples_by_frame, std::size_t frame_index,
                                    const std::vector<LidarSample>& samples,
                                    const std::vector<LidarSample>& changing_samples, double gait_period_m,
                                    const SceneInitialisationOptions& options, double incidence_coefficient) {
    const FrameSamples& frame = *samples_by_frame[frame_index];
    std::vector<glm::vec3> shifts(changing_samples.size());
    parallel_for_in_blocks(changing_samples.size(), [&](std::size_t i) {
        shifts[i] =
            estimate_surface_shift_per_frame(samples_by_frame, frame_index, samples, changing_samples[i]);
    });
    std::vector<GaitPhaseWindow> gait;
    for (const glm::vec3& shift : smooth_shifts_by_median(changing_samples, shifts))
        gait.push_back({float(frame.walked_m / gait_period_m),
                        float(gait_period_m / (2.0 * kPi * frame.spacing_m)),
                        float(gait_period_m / (2.0 * kPi * frame.spacing_m)) * shift});
    return make_surfels_with_gait(changing_samples, gait, options, incidence_coefficient);
}

}  // namespace

DeformingActorSurfels make_surfels_of_deforming_actor(const std::vector<LidarSample>& samples,
                                                      const SceneInitialisationOptions& options,
                                                      double incidence_coefficient, std::size_t max_surfels,
                                                      const ProgressReporter& progress) {
    const SamplesByFrame frames = group_samples_by_frame(samples);
    if (frames.size() < kFewestChanging)
        return {{},
                0.0,
                fmt::format("the actor has LiDAR points in only {} frames, expected at least {}",
                            frames.size(), kFewestChanging)};
    const double recorded_m = frames.back()->walked_m - frames.front()->walked_m;
    if (recorded_m < kFewestWalked_m)
        return {
            {}, 0.0, fmt::format("it walked {:.1f} m, expected at least {} m", recorded_m, kFewestWalked_m)};
    DeformingActorSurfels actor;
    actor.period_m = recorded_m * (1.0 + kFramesBetween / double(frames.size() - 1));
    const std::vector<char> rests = mark_static_samples(samples, frames);
    std::vector<LidarSample> resting;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (rests[i]) resting.push_back(samples[i]);
    if (!resting.empty()) {
        resting = select_one_sample_per_voxel(resting, max_surfels / 2);
        actor.surfels = make_surfels_with_gait(resting, std::vector<GaitPhaseWindow>(resting.size()), options,
                                               incidence_coefficient);
    }
    const std::size_t most_in_frame =
        std::max((max_surfels - actor.surfels.size()) / frames.size(), kInFrame);
    for (std::size_t k = 0; k < frames.size(); ++k) {
        if (progress) progress("modelling the walking of actors", double(k) / double(frames.size()));
        std::vector<LidarSample> changing;
        for (const std::uint32_t i : frames[k]->index.cloud.of)
            if (!rests[i]) changing.push_back(samples[i]);
        if (changing.empty()) continue;
        changing = select_one_sample_per_voxel(changing, most_in_frame);
        actor.surfels.append_surfels(make_actor_surfels_of_frame(frames, k, samples, changing, actor.period_m,
                                                                 options, incidence_coefficient));
    }
    actor.surfels = actor.surfels.reorder(compute_kd_tree_order(actor.surfels.mean));
    return actor;
}

}  // namespace relidar
