// SPDX-License-Identifier: Apache-2.0
// Makes surfels from the points of each frame. They are visible only around the time of
// their frame, and move with the points of the neighbouring frames. This models every
// change of shape: steps, pedals, doors, trailers.

#include <fmt/format.h>
#include <cmath>
#include <nanoflann.hpp>
#include <numeric>

#include <relidar/scene/labels.hpp>

#include "base/median.hpp"
#include "base/parallel.hpp"
#include "base/sigmoid.hpp"
#include "scene/point_surfels.hpp"

namespace relidar {
namespace {

constexpr double kSameSurface_m = 0.07;   // maximum distance between points of the same surface
constexpr double kMinStaticShare = 0.75;  // minimum share of the frames with a point at a static position
constexpr std::size_t kMaxComparedFrames = 64;  // maximum number of frames that are searched for this share
constexpr std::size_t kInFrame = 200;           // minimum number of surfels of a frame
// An actor in fewer frames, or that walks less, is modelled as rigid.
constexpr std::size_t kFewestChanging = 3;
// kSmallestSpacing_m is a lower limit for the distance that it walks per frame.
constexpr double kFewestWalked_m = 0.5, kSmallestSpacing_m = 0.02;
// An actor repeats its recorded walk in a loop. Ratio (distance walked from the last
// frame to the repeated first frame) / (mean distance walked per frame). A low ratio
// would show both frames simultaneously.
constexpr double kFramesBetween = 3.0;

constexpr double kAveraging_s = 1.0;  // time over which positions are averaged, because labels jitter
constexpr double kMaxStandingSpeed_mps = 0.2;

/// Adapter that gives nanoflann access to some of the samples.
struct SampleCloud {
    const LidarSamples& samples;
    SampleIndices of;  ///< indices of the samples
    std::size_t kdtree_get_point_count() const { return of.size(); }
    float kdtree_get_pt(std::size_t index, std::size_t axis) const {
        return samples[of[index]].position[int(axis)];
    }
    bool kdtree_get_bbox(auto&) const { return false; }
};
using SampleTree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, SampleCloud>,
                                                       SampleCloud, 3, std::size_t>;

/// Spatial index of a subset of the samples.
struct SampleIndex {
    SampleCloud cloud;
    SampleTree tree;
    SampleIndex(const LidarSamples& samples, SampleIndices indices)
        : cloud{samples, std::move(indices)}, tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(8)) {}

    /// Limited to `max_distance_m`.
    double nearest_m(const glm::vec3& point_m, double max_distance_m) const {
        if (cloud.of.empty()) return max_distance_m;
        std::size_t nearest;
        float distance2;
        tree.knnSearch(&point_m.x, 1, &nearest, &distance2);
        return std::min(max_distance_m, std::sqrt(double(distance2)));
    }
    /// Returns at most `max_count` indices of samples, sorted by distance.
    SampleIndices find_in_radius(const glm::vec3& point_m, double radius_m, std::size_t max_count) const {
        std::vector<std::size_t> tree_indices(max_count);
        std::vector<float> distance2(max_count);
        if (cloud.of.empty()) return {};
        tree_indices.resize(tree.knnSearch(&point_m.x, max_count, tree_indices.data(), distance2.data()));
        SampleIndices numbers;
        for (std::size_t k = 0; k < tree_indices.size() && double(distance2[k]) < radius_m * radius_m; ++k)
            numbers.push_back(cloud.of[tree_indices[k]]);
        return numbers;
    }
};

struct FrameSamples {
    SampleIndex index;
    double walked_m = 0.0;   ///< Mean walked distance of the samples.
    double spacing_m = 0.0;  ///< Mean difference of walked distance to the previous and the next frame.

    FrameSamples(const LidarSamples& samples, std::vector<std::uint32_t> indices)
        : index(samples, std::move(indices)) {
        for (const std::uint32_t i : index.cloud.of)
            walked_m += double(samples[i].walked_m) / double(index.cloud.of.size());
    }
};
using SamplesByFrame = std::vector<std::unique_ptr<FrameSamples>>;

/// Groups the samples by frame, and computes the distance that the actor walks per frame.
SamplesByFrame group_by_frame(const LidarSamples& samples) {
    std::map<int, SampleIndices> by_frame;
    for (std::size_t i = 0; i < samples.size(); ++i) by_frame[samples[i].frame].push_back(std::uint32_t(i));
    SamplesByFrame frames;
    for (auto& [frame, of_frame] : by_frame)
        frames.push_back(std::make_unique<FrameSamples>(samples, std::move(of_frame)));
    for (std::size_t k = 0; k < frames.size(); ++k) {
        const std::size_t before = k > 0 ? k - 1 : 0, after = std::min(k + 1, frames.size() - 1);
        frames[k]->spacing_m = std::max((frames[after]->walked_m - frames[before]->walked_m) /
                                            double(std::max<std::size_t>(after - before, 1)),
                                        kSmallestSpacing_m);
    }
    return frames;
}

/// Returns how badly a shift per frame moves some points of a frame onto the points of
/// two earlier and two later frames: the sum of the distances to the nearest points, each
/// at most kMaxMatchDistance_m. `patch`: indices of the points
double shift_cost(const SamplesByFrame& frames, std::size_t frame, const LidarSamples& samples,
                  const SampleIndices& patch, const glm::vec3& shift) {
    constexpr double kMaxMatchDistance_m = 0.15;
    constexpr float kMaxFrames = 3.0f;  // points that have moved farther are not comparable
    const FrameSamples& here = *frames[frame];
    // A small cost selects the smallest of several equally good shifts.
    double sum = 1e-3 * double(glm::length(shift));
    const std::size_t first = frame - std::min<std::size_t>(frame, 2),
                      last = std::min(frame + 2, frames.size() - 1);
    for (std::size_t other = first; other <= last; ++other) {
        // The walk between both frames, in units of the mean walk from frame to frame.
        const auto n_frames = float((frames[other]->walked_m - here.walked_m) / here.spacing_m);
        if (other == frame || std::abs(n_frames) > kMaxFrames) continue;
        for (const std::uint32_t i : patch)
            sum +=
                frames[other]->index.nearest_m(samples[i].position + n_frames * shift, kMaxMatchDistance_m);
    }
    return sum;
}

/// Estimates how the surface around a sample moves in the box of the actor, in metres per
/// frame. Tries a grid of shifts along x and z, because actors do not move sideways.
glm::vec3 estimate_shift(const SamplesByFrame& frames, std::size_t frame, const LidarSamples& samples,
                         const LidarSample& sample) {
    constexpr float kMaxShift_m = 0.3f, kMaxShiftUp_m = 0.08f, kShiftStep_m = 0.04f;
    constexpr double kPatchRadius_m = 0.12;
    constexpr std::size_t kMaxPatchPoints = 6;
    const SampleIndices patch =
        frames[frame]->index.find_in_radius(sample.position, kPatchRadius_m, kMaxPatchPoints);
    glm::vec3 best(0.0f);
    double lowest_cost = std::numeric_limits<double>::infinity();
    for (float x = -kMaxShift_m; x < kMaxShift_m + 0.5f * kShiftStep_m; x += kShiftStep_m)
        for (float z = -kMaxShiftUp_m; z < kMaxShiftUp_m + 0.5f * kShiftStep_m; z += kShiftStep_m) {
            const glm::vec3 shift(x, 0.0f, z);
            const double cost = shift_cost(frames, frame, samples, patch, shift);
            if (cost < lowest_cost) {
                lowest_cost = cost;
                best = shift;
            }
        }
    return best;
}

/// Replaces each shift by the median of the shifts at the nearest samples, per axis.
std::vector<glm::vec3> smooth_shifts(const LidarSamples& samples, const std::vector<glm::vec3>& shifts) {
    constexpr double kSmoothingRadius_m = 0.15;
    constexpr std::size_t kMaxSmoothed = 9;
    std::vector<std::uint32_t> all(samples.size());
    std::iota(all.begin(), all.end(), 0u);
    const SampleIndex index(samples, all);
    std::vector<glm::vec3> medians(shifts);  // samples without a neighbour keep their shift
    for (std::size_t i = 0; i < samples.size(); ++i)
        for (int axis = 0; axis < 3; ++axis) {
            std::vector<float> values;
            for (const std::uint32_t j :
                 index.find_in_radius(samples[i].position, kSmoothingRadius_m, kMaxSmoothed))
                values.push_back(shifts[j][axis]);
            if (!values.empty()) medians[i][axis] = compute_median(std::move(values));
        }
    return medians;
}

/// Makes one surfel for each sample. `gaits[i]` defines in which phase of the walk the
/// surfel of sample i is visible, and how it moves.
Surfels make_gait_surfels(const LidarSamples& samples, const std::vector<GaitPhaseWindow>& gaits,
                          const InitOptions& options, double incidence) {
    std::vector<std::uint32_t> order;
    Surfels surfels = make_surfels(samples, options, incidence, {}, &order);
    surfels.add_still_gait();
    for (std::size_t i = 0; i < order.size(); ++i) surfels.gait[i] = gaits[order[i]];
    return surfels;
}

/// Returns true for each sample near which most frames have a point, because the shape of
/// the actor does not change there. Compares at most kMaxComparedFrames frames.
std::vector<char> mark_static(const LidarSamples& samples, const SamplesByFrame& frames) {
    std::vector<char> is_static(samples.size());
    const std::size_t step = frames.size() / kMaxComparedFrames + 1;
    parallel_blocks(samples.size(), [&](std::size_t index) {
        std::size_t n_frames_with_point = 0, n_frames = 0;
        for (std::size_t k = 0; k < frames.size(); k += step, ++n_frames)
            n_frames_with_point += frames[k]->index.nearest_m(samples[index].position, 1.0) < kSameSurface_m;
        is_static[index] = double(n_frames_with_point) >= kMinStaticShare * double(n_frames);
    });
    return is_static;
}

/// Makes surfels with the shape of an actor in one frame, which fade out while the actor
/// walks on. A surfel has
///   position = mean + swing sin(a),  opacity = o exp(sharpness^2 (cos(a) - 1))
/// at the angle a = 2 pi (walked_m / period_m - phase) of the walk after this frame.
/// @param changing samples of this frame where the shape of the actor changes
/// @param period_m walked distance after which the motion repeats
/// @param incidence strength of the dependence of intensities on the angle
Surfels make_frame_surfels(const SamplesByFrame& by_frame, std::size_t frame_index,
                           const LidarSamples& samples, const LidarSamples& changing, double period_m,
                           const InitOptions& options, double incidence) {
    const FrameSamples& frame = *by_frame[frame_index];
    std::vector<glm::vec3> shifts(changing.size());
    parallel_blocks(changing.size(), [&](std::size_t i) {
        shifts[i] = estimate_shift(by_frame, frame_index, samples, changing[i]);
    });
    // From frame to frame, a grows by 1 / frames_per_rad and a point moves by its shift,
    // so the swing is frames_per_rad * shift. At a small a, the opacity has the factor
    // exp(-(sharpness a)^2 / 2), whose standard deviation shall be one frame.
    const auto frames_per_rad = float(period_m / (2.0 * kPi * frame.spacing_m));
    std::vector<GaitPhaseWindow> gaits;
    for (const glm::vec3& shift : smooth_shifts(changing, shifts))
        gaits.push_back({.phase = float(frame.walked_m / period_m),
                         .sharpness = frames_per_rad,
                         .swing = frames_per_rad * shift});
    return make_gait_surfels(changing, gaits, options, incidence);
}

/// Returns the smallest sharpness with which a surfel is invisible when its centre swings
/// out of the box of its actor, or 0 if the centre stays inside. At the angle a of the
/// walk, the offset of the centre is swing_m sin(a), and the opacity has the factor
/// exp(sharpness^2 (cos(a) - 1)) = exp(-(sharpness sin(a))^2 / (1 + cos(a))).
/// @param room_m distance from the centre, without swing, to the sides of the box
/// @param opacity  at a = 0; must exceed `alpha_min`, below which the surfel is invisible
float find_hiding_sharpness(const glm::vec3& swing_m, const glm::vec3& room_m, float opacity,
                            float alpha_min) {
    constexpr float kMinRoom_m = 0.01f;  // for surfels whose mean is already outside
    float sine = 1.0f;                   // of the angle at which the centre leaves the box
    for (int axis = 0; axis < 3; ++axis) {
        const float swing = std::abs(swing_m[axis]);
        if (swing > 0.0f) sine = std::min(sine, std::max(room_m[axis], kMinRoom_m) / swing);
    }
    if (sine >= 1.0f) return 0.0f;
    // Solves alpha_min = opacity exp(-(sharpness sine)^2 / (1 + cosine)).
    const float cosine = std::sqrt(1.0f - sine * sine);
    return std::sqrt(std::log(opacity / alpha_min) * (1.0f + cosine)) / sine;
}

}  // namespace

DeformingActorSurfels make_deforming(const LidarSamples& samples, const InitOptions& options,
                                     double incidence, std::size_t max_count, const Progress& progress) {
    const SamplesByFrame frames = group_by_frame(samples);
    if (frames.size() < kFewestChanging)
        return {.surfels = {},
                .why_rigid = fmt::format("the actor has LiDAR points in only {} frames, expected at least {}",
                                         frames.size(), kFewestChanging)};
    const double recorded_m = frames.back()->walked_m - frames.front()->walked_m;
    if (recorded_m < kFewestWalked_m)
        return {.surfels = {},
                .why_rigid =
                    fmt::format("it walked {:.1f} m, expected at least {} m", recorded_m, kFewestWalked_m)};
    DeformingActorSurfels actor;
    // The walk repeats kFramesBetween times the mean distance per frame after its end.
    actor.period_m = recorded_m * (1.0 + kFramesBetween / double(frames.size() - 1));
    // Parts that do not change are modelled once for all frames, with default gaits that
    // are always visible. They get at most half of the surfels.
    const std::vector<char> is_static = mark_static(samples, frames);
    LidarSamples static_samples;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (is_static[i]) static_samples.push_back(samples[i]);
    if (!static_samples.empty()) {
        static_samples = thin_samples(static_samples, max_count / 2);
        const std::vector<GaitPhaseWindow> still(static_samples.size());
        actor.surfels = make_gait_surfels(static_samples, still, options, incidence);
    }
    // The frames share the remaining surfels for the parts that change.
    const std::size_t max_in_frame = std::max((max_count - actor.surfels.size()) / frames.size(), kInFrame);
    for (std::size_t k = 0; k < frames.size(); ++k) {
        if (progress) progress("modelling the walking of actors", double(k) / double(frames.size()));
        LidarSamples changing;
        for (const std::uint32_t i : frames[k]->index.cloud.of)
            if (!is_static[i]) changing.push_back(samples[i]);
        if (changing.empty()) continue;
        changing = thin_samples(changing, max_in_frame);
        actor.surfels.append_surfels(
            make_frame_surfels(frames, k, samples, changing, actor.period_m, options, incidence));
    }
    actor.surfels = actor.surfels.reorder(kd_tree_order(actor.surfels.mean));
    return actor;
}

void fade_far_swings(Scene& scene, float alpha_min) {
    constexpr float kSwingMargin_m = 0.1f;  // the box of a model already has a margin of kObjectMargin_m
    Surfels& surfels = scene.surfels;
    if (!surfels.bends) return;
    for (const SurfelModel& model : scene.models) {
        if (model.stride_m <= 0.0f) continue;  // does not walk, so its surfels do not swing
        for (std::size_t i = model.first; i < std::size_t(model.first) + model.count; ++i) {
            GaitPhaseWindow& gait = surfels.gait[i];
            const glm::vec3 room_m = model.half_size_m + kSwingMargin_m - glm::abs(surfels.mean[i]);
            const float opacity = sigmoid(surfels.opacity_logit[i]);
            if (opacity <= alpha_min) continue;  // never visible
            // A larger sharpness makes the surfel fade at a smaller angle of the walk.
            const float hiding_sharpness = find_hiding_sharpness(gait.swing, room_m, opacity, alpha_min);
            if (hiding_sharpness > 0.0f)
                gait.sharpness = std::max(std::abs(gait.sharpness), hiding_sharpness);
        }
    }
}

/// Sums up the distances between the mean positions at successive poses. A mean is over
/// up to kAveraging_s around its time, because labelled boxes jitter.
WalkedDistanceTrack::WalkedDistanceTrack(const PoseTrack& track) : time_s_(track.time_s) {
    const auto mean_position = [&](double t_s) {
        // The window shrinks near the ends of the track, so that it stays symmetric.
        const double half_s = std::min({0.5 * kAveraging_s, t_s - time_s_.front(), time_s_.back() - t_s});
        constexpr int kStepsPerSide = 5;  // number of steps in each direction
        glm::dvec3 sum(0.0);
        for (int k = -kStepsPerSide; k <= kStepsPerSide; ++k)
            sum += track.pose_at(t_s + half_s * k / kStepsPerSide).translation;
        return sum / double(2 * kStepsPerSide + 1);
    };
    glm::dvec3 previous(0.0);
    double distance_m = 0.0;
    for (std::size_t i = 0; i < time_s_.size(); ++i) {
        const glm::dvec3 position = mean_position(time_s_[i]);
        if (i > 0) {
            // Slower steps are jitter of the labels or standing, so they add no distance.
            const double step_m = glm::distance(previous, position);
            if (step_m > kMaxStandingSpeed_mps * (time_s_[i] - time_s_[i - 1])) distance_m += step_m;
        }
        walked_m_.push_back(distance_m);
        previous = position;
    }
}

double WalkedDistanceTrack::walked_m(double t_s) const {
    if (time_s_.size() < 2) return 0.0;
    const auto next = std::upper_bound(time_s_.begin() + 1, time_s_.end() - 1, t_s);
    const std::size_t i = std::size_t(next - time_s_.begin());
    const double share = (t_s - time_s_[i - 1]) / (time_s_[i] - time_s_[i - 1]);
    return walked_m_[i - 1] + share * (walked_m_[i] - walked_m_[i - 1]);
}

}  // namespace relidar
