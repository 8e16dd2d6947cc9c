// SPDX-License-Identifier: Apache-2.0
#include "read/bag/survey.hpp"

#include <algorithm>
#include <cmath>
#include <ranges>

namespace relidar::bag {
namespace {

// Poses are extrapolated by at most this time before the first sample and after the last
// sample. It is about the duration of one sweep.
constexpr double kMaxExtrapolation_s = 0.1;
constexpr std::size_t kMaxDepth = 64;  // maximum depth of the tree
// A step of a pose is a jump if it is longer than both: noise of good poses, and what
// three times the acceleration of gravity can cause.
constexpr double kMinJump_m = 0.1, kMaxAcceleration = 30.0;

/// Returns true if two poses differ only by rounding errors.
bool are_poses_equal(const Pose& first, const Pose& second) {
    constexpr double kMaxShift_m = 1e-6, kMinCosine = 1.0 - 1e-12;  // cosine of half the angle
    return glm::distance(first.translation, second.translation) <= kMaxShift_m &&
           std::abs(glm::dot(first.rotation, second.rotation)) >= kMinCosine;
}

}  // namespace

void TransformChain::append_samples(const std::vector<StampedPose>& pose_samples, LogClock clock,
                                    std::int64_t origin_ns) {
    std::vector<const StampedPose*> sorted;
    for (const StampedPose& sample : pose_samples) sorted.push_back(&sample);
    std::ranges::stable_sort(sorted, {}, [&](const StampedPose* sample) { return sample->time_ns(clock); });
    PoseTrack track;
    std::int64_t last_ns = 0;
    for (const StampedPose* sample : sorted) {
        const std::int64_t time_ns = sample->time_ns(clock);
        // Interpolation needs increasing times, so only the first of equal times is used.
        if (!track.time_s.empty() && time_ns == last_ns) continue;
        last_ns = time_ns;
        track.time_s.push_back(1e-9 * double(time_ns - origin_ns));
        track.pose.push_back(sample->pose);
    }
    links_.push_back(std::move(track));
}

Pose TransformChain::compute_pose_at(double t_s) const {
    Pose pose;
    for (const PoseTrack& link : links_)
        pose = pose * (link.pose.size() == 1 ? link.pose[0] : link.pose_at(t_s));
    return is_inverse_ ? inverse(pose) : pose;
}

bool TransformChain::covers_time(double t_s) const {
    return std::ranges::all_of(links_, [&](const PoseTrack& link) {
        return link.pose.size() == 1 || (t_s >= link.time_s.front() - kMaxExtrapolation_s &&
                                         t_s <= link.time_s.back() + kMaxExtrapolation_s);
    });
}

std::vector<PoseJump> TransformChain::find_jumps() const {
    std::vector<PoseJump> jumps;
    for (const auto& [time_s, pose] : links_) {
        const auto velocity_mps = [&](std::size_t k) {  // from sample k - 1 to sample k
            return (pose[k].translation - pose[k - 1].translation) / (time_s[k] - time_s[k - 1]);
        };
        for (std::size_t k = 2; k + 1 < pose.size(); ++k) {
            const double step_s = time_s[k] - time_s[k - 1];
            // Only the more similar neighbour counts, because the other may be the jump.
            const double distance_m = step_s * std::min(glm::distance(velocity_mps(k), velocity_mps(k - 1)),
                                                        glm::distance(velocity_mps(k), velocity_mps(k + 1)));
            if (distance_m > kMinJump_m && distance_m > kMaxAcceleration * step_s * step_s)
                jumps.push_back({time_s[k - 1], time_s[k], distance_m});
        }
    }
    std::ranges::sort(jumps, {}, &PoseJump::first_s);
    return jumps;
}

void FrameTree::add_transform(const TransformMessage& transform, std::int64_t log_ns, bool is_static) {
    if (transform.child.empty() || transform.child == transform.header.frame) return;
    FrameTreeEdge& edge = parents_[transform.child][transform.header.frame];
    edge.is_static = is_static;
    if (is_static) edge.samples.clear();  // a static transform keeps only its latest sample
    if (!edge.samples.empty() && !are_poses_equal(edge.samples.front().pose, transform.parent_from_child))
        edge.changes = true;
    edge.samples.push_back({{transform.header.stamp_ns, log_ns}, transform.parent_from_child});
}

const std::pair<const std::string, FrameTree::FrameTreeEdge>* FrameTree::find_parent(
    const std::string& frame) const {
    const auto parents_entry = parents_.find(frame);
    if (parents_entry == parents_.end()) return nullptr;
    return &*std::ranges::max_element(parents_entry->second, {},
                                      [](const auto& parent) { return parent.second.samples.size(); });
}

std::vector<std::string> FrameTree::path_to_root(const std::string& start_frame) const {
    std::vector<std::string> frame_chain{start_frame};
    while (frame_chain.size() < kMaxDepth) {
        const auto* up = find_parent(frame_chain.back());
        if (!up || std::ranges::find(frame_chain, up->first) != frame_chain.end()) break;
        frame_chain.push_back(up->first);
    }
    return frame_chain;
}

bool FrameTree::is_frame_moving(const std::string& frame) const {
    const auto* up = find_parent(frame);
    return up && !up->second.is_static && up->second.changes;
}

std::optional<Pose> FrameTree::find_constant(const std::string& target, const std::string& source) const {
    const std::vector<std::string> target_chain = path_to_root(target), source_chain = path_to_root(source);
    const auto common = std::ranges::find_first_of(source_chain, target_chain);
    if (common == source_chain.end()) return std::nullopt;
    // Multiplies the transforms from a frame up to the common ancestor. Returns nothing
    // if one of the transforms changes over time.
    const auto climb = [&](const std::vector<std::string>& frame_chain) -> std::optional<Pose> {
        Pose pose;
        for (auto frame = frame_chain.begin(); *frame != *common; ++frame) {
            if (is_frame_moving(*frame)) return std::nullopt;
            pose = find_parent(*frame)->second.samples.back().pose * pose;
        }
        return pose;
    };
    const std::optional<Pose> common_from_target = climb(target_chain);
    const std::optional<Pose> common_from_source = climb(source_chain);
    if (!common_from_target || !common_from_source) return std::nullopt;
    return inverse(*common_from_target) * *common_from_source;
}

TransformChain FrameTree::make_chain(const std::string& ancestor_frame, const std::string& child_frame,
                                     LogClock clock, std::int64_t time_origin_ns) const {
    const std::vector<std::string> frame_chain = path_to_root(child_frame);
    TransformChain path;
    // The chain lists the frames from the child up to the root. Appends the transforms of
    // those below the ancestor, from top to bottom.
    const auto ancestor = std::ranges::find(frame_chain, ancestor_frame);
    for (const std::string& frame :
         std::ranges::subrange(frame_chain.begin(), ancestor) | std::views::reverse) {
        const FrameTreeEdge& edge = find_parent(frame)->second;
        if (is_frame_moving(frame)) path.append_samples(edge.samples, clock, time_origin_ns);
        else path.append_constant(edge.samples.back().pose);
    }
    return path;
}

const std::vector<StampedPose>* FrameTree::densest_samples(const std::string& ancestor_frame,
                                                           const std::string& child_frame) const {
    const std::vector<StampedPose>* densest = nullptr;
    for (const std::string& frame : path_to_root(child_frame)) {
        if (frame == ancestor_frame) break;
        if (!is_frame_moving(frame)) continue;
        const std::vector<StampedPose>& samples = find_parent(frame)->second.samples;
        if (!densest || samples.size() > densest->size()) densest = &samples;
    }
    return densest;
}

std::optional<FramePose> FrameTree::find_chain(const std::string& target_frame,
                                               const std::string& source_frame, LogClock clock,
                                               std::int64_t time_origin_ns) const {
    const std::vector<std::string> target_ancestors = path_to_root(target_frame),
                                   source_ancestors = path_to_root(source_frame);
    const auto common = std::ranges::find_first_of(source_ancestors, target_ancestors);
    if (common == source_ancestors.end()) return std::nullopt;
    return FramePose{.ancestor_from_target = make_chain(*common, target_frame, clock, time_origin_ns),
                     .ancestor_from_source = make_chain(*common, source_frame, clock, time_origin_ns)};
}

std::vector<std::string> FrameTree::moving_frames() const {
    std::vector<std::string> names;
    for (const auto& [frame, parents] : parents_)
        if (is_frame_moving(frame)) names.push_back(frame);
    return names;
}

std::vector<std::string> FrameTree::ambiguous_frames() const {
    std::vector<std::string> names;
    for (const auto& [frame, parents] : parents_)
        if (parents.size() > 1) names.push_back(frame);
    return names;
}

}  // namespace relidar::bag
