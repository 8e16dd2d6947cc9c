// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/frame_tree.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::bag {
namespace {

// Poses are valid up to this time before the first and after the last sample, about one
// sweep.
constexpr double kBeside_s = 0.1;
constexpr std::size_t kDeepest = 64;  // maximum depth of the tree

/// Returns true if two poses differ by more than rounding errors.
bool are_poses_different(const Pose& first, const Pose& second) {
    return glm::distance(first.translation, second.translation) > 1e-6 ||
           std::abs(glm::dot(first.rotation, second.rotation)) < 1.0 - 1e-12;
}

}  // namespace

void PosePath::add(const std::vector<PoseSample>& samples, Clock clock, std::int64_t zero_ns) {
    std::vector<const PoseSample*> sorted;
    for (const PoseSample& sample : samples) sorted.push_back(&sample);
    std::ranges::stable_sort(sorted, {}, [&](const PoseSample* sample) { return sample->time_ns(clock); });
    PoseTrack track;
    std::int64_t last_ns = 0;
    for (const PoseSample* sample : sorted) {
        const std::int64_t time_ns = sample->time_ns(clock);
        if (!track.time_s.empty() && time_ns == last_ns) continue;
        last_ns = time_ns;
        track.time_s.push_back(1e-9 * double(time_ns - zero_ns));
        track.pose.push_back(sample->pose);
    }
    links_.push_back(std::move(track));
}

Pose PosePath::at(double t_s) const {
    Pose pose;
    for (const PoseTrack& link : links_) pose = pose * (link.pose.size() == 1 ? link.pose[0] : link.at(t_s));
    return pose;
}

bool PosePath::covers(double t_s) const {
    return std::ranges::all_of(links_, [&](const PoseTrack& link) {
        return link.pose.size() == 1 ||
               (t_s >= link.time_s.front() - kBeside_s && t_s <= link.time_s.back() + kBeside_s);
    });
}

bool PosePath::is_moving() const {
    return std::ranges::any_of(links_, [](const PoseTrack& link) { return link.pose.size() > 1; });
}

void FrameTree::add(const Transform& transform, std::int64_t log_ns, bool is_static) {
    if (transform.child.empty() || transform.child == transform.header.frame) return;
    Link& link = parents_[transform.child][transform.header.frame];
    link.is_static = is_static;
    if (is_static) link.samples.clear();  // keeps only the latest sample of a static transform
    if (!link.samples.empty())
        link.changes =
            link.changes || are_poses_different(link.samples.front().pose, transform.parent_from_child);
    link.samples.push_back({transform.header.stamp_ns, log_ns, transform.parent_from_child});
}

const std::pair<const std::string, FrameTree::Link>* FrameTree::find_parent_link(
    const std::string& frame) const {
    const auto known = parents_.find(frame);
    if (known == parents_.end()) return nullptr;
    return &*std::ranges::max_element(known->second, {},
                                      [](const auto& parent) { return parent.second.samples.size(); });
}

std::vector<std::string> FrameTree::find_path_to_root(const std::string& frame) const {
    std::vector<std::string> way{frame};
    while (way.size() < kDeepest) {
        const auto* up = find_parent_link(way.back());
        if (!up || std::ranges::find(way, up->first) != way.end()) break;
        way.push_back(up->first);
    }
    return way;
}

bool FrameTree::is_moving(const std::string& frame) const {
    const auto* up = find_parent_link(frame);
    return up && !up->second.is_static && up->second.changes;
}

std::optional<Pose> FrameTree::find_constant_pose(const std::string& target_frame,
                                                  const std::string& source_frame) const {
    const std::vector<std::string> way_to = find_path_to_root(target_frame),
                                   way_from = find_path_to_root(source_frame);
    const auto common = std::ranges::find_first_of(way_from, way_to);
    if (common == way_from.end()) return std::nullopt;
    // Multiplies the transforms from a frame up to the common ancestor of both frames.
    // Returns nothing if one of them changes over time.
    const auto climb = [&](const std::vector<std::string>& way) -> std::optional<Pose> {
        Pose pose;
        for (const std::string& frame : way) {
            if (frame == *common) return pose;
            if (is_moving(frame)) return std::nullopt;
            pose = find_parent_link(frame)->second.samples.back().pose * pose;
        }
        return std::nullopt;
    };
    const std::optional<Pose> of_to = climb(way_to), of_from = climb(way_from);
    if (!of_to || !of_from) return std::nullopt;
    return inverse(*of_to) * *of_from;
}

PosePath FrameTree::path(const std::string& outer, const std::string& frame, Clock clock,
                         std::int64_t zero_ns) const {
    const std::vector<std::string> way = find_path_to_root(frame);
    PosePath path;
    for (std::size_t k = std::size_t(std::ranges::find(way, outer) - way.begin()); k-- > 0;) {
        const Link& up = find_parent_link(way[k])->second;
        if (is_moving(way[k])) path.add(up.samples, clock, zero_ns);
        else path.add(up.samples.back().pose);
    }
    return path;
}

std::optional<FramesApart> FrameTree::find_relative_poses(const std::string& target_frame,
                                                          const std::string& source_frame, Clock clock,
                                                          std::int64_t zero_ns) const {
    const std::vector<std::string> way_to = find_path_to_root(target_frame),
                                   way_from = find_path_to_root(source_frame);
    const auto common = std::ranges::find_first_of(way_from, way_to);
    if (common == way_from.end()) return std::nullopt;
    return FramesApart{path(*common, target_frame, clock, zero_ns),
                       path(*common, source_frame, clock, zero_ns)};
}

std::vector<std::string> FrameTree::list_disputed_frames() const {
    std::vector<std::string> names;
    for (const auto& [frame, parents] : parents_)
        if (parents.size() > 1) names.push_back(frame);
    return names;
}

}  // namespace relidar::bag
