// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/bag_boxes.hpp"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/clouds.hpp>

#include "base/files.hpp"
#include "log/clouds/match_sweeps.hpp"
#include "log/readers/bag/recording_notes.hpp"

namespace relidar::bag {
namespace {

constexpr const char* kNoCategory = "unknown";

/// Computes the pose of a coordinate frame of the bag in the world frame at a given time.
class WorldFrames {
public:
    explicit WorldFrames(const BoxPlaces& places) : places_(places) {}

    /// Returns the pose of a coordinate frame in the world frame, or nothing if the bag
    /// does not contain this pose at the time.
    std::optional<Pose> at(const std::string& frame, double t_s) {
        if (places_.is_world_of_poses && frame == places_.poses.world) return Pose{};
        auto known = apart_.find(frame);
        if (known == apart_.end())
            known =
                apart_
                    .emplace(frame, places_.frames.find_relative_poses(
                                        places_.vehicle, frame, places_.poses.clock, places_.poses.zero_ns))
                    .first;
        if (!known->second || !known->second->covers(t_s)) return std::nullopt;
        if (places_.is_world_of_poses && !places_.poses.path->covers(t_s)) return std::nullopt;
        return places_.world_from_vehicle(t_s) * known->second->at(t_s);
    }

private:
    const BoxPlaces& places_;
    std::map<std::string, std::optional<FramesApart>> apart_;
};

/// Sorts box labels by time. Removes repeated labels of an object at the same time.
/// @return number of removed labels
std::size_t sort_unique_labels(std::vector<BoxLabel>& labels) {
    std::ranges::stable_sort(labels, {}, &BoxLabel::time_s);
    std::map<std::string, double> last_s;
    return std::erase_if(labels, [&](const BoxLabel& label) {
        const auto [known, is_new] = last_s.try_emplace(label.id, label.time_s);
        return !is_new && std::exchange(known->second, label.time_s) == label.time_s;
    });
}

/// Gives all labels of an object its most frequent category and its median size, because
/// object trackers change both over time.
void unify_label_properties(std::vector<BoxLabel>& labels) {
    std::map<std::string, std::vector<const BoxLabel*>> things;
    for (const BoxLabel& label : labels) things[label.id].push_back(&label);
    std::map<std::string, std::pair<glm::dvec3, std::string>> settled;
    for (auto& [id, seen] : things) {
        glm::dvec3 size_m;
        for (int a = 0; a < 3; ++a) {
            const auto middle = seen.begin() + std::ptrdiff_t(seen.size() / 2);
            std::ranges::nth_element(seen, middle, {},
                                     [a](const BoxLabel* label) { return label->size_m[a]; });
            size_m[a] = (*middle)->size_m[a];
        }
        std::map<std::string, std::size_t> votes;
        for (const BoxLabel* label : seen) ++votes[label->category];
        if (votes.size() > 1) votes.erase(kNoCategory);
        settled[id] = {
            size_m, std::ranges::max_element(votes, {}, [](const auto& vote) { return vote.second; })->first};
    }
    for (BoxLabel& label : labels) std::tie(label.size_m, label.category) = settled[label.id];
}

/// Reads the box messages of a topic and converts the boxes to the world frame.
class LabelReader {
public:
    LabelReader(const BoxPlaces& places, double first_s, double last_s)
        : places_(places), frames_(places), first_s_(first_s), last_s_(last_s) {}

    bool is_wanted(double t_s) const { return t_s >= first_s_ && t_s <= last_s_; }
    double seconds(std::int64_t stamp_ns, std::int64_t log_ns) const {
        const bool is_recorded = places_.poses.clock == Clock::recorder || stamp_ns == 0;
        return 1e-9 * double((is_recorded ? log_ns : stamp_ns) - places_.poses.zero_ns);
    }

    void add_box_list(const BoxList& list, std::int64_t log_ns) {
        for (const Box& box : list.boxes) {
            const double t_s = seconds(box.header.stamp_ns, log_ns);
            if (box.id.empty() || !is_wanted(t_s)) continue;
            const std::optional<Pose> world_from_frame = frames_.at(box.header.frame, t_s);
            if (!world_from_frame) {
                ++n_unplaced_;
                unplaced_.insert(box.header.frame);
                continue;
            }
            labels_.push_back({box.id, box.category.empty() ? kNoCategory : box.category, box.size_m, t_s,
                               *world_from_frame * box.frame_from_box});
        }
    }

    BoxTracks tracks() {
        BoxTracks result;
        if (n_unplaced_ > 0)
            result.notes.push_back(fmt::format(
                "{} boxes are skipped, because the pose of the frame '{}' in the frame '{}' is unknown at "
                "their times",
                n_unplaced_, make_excerpt(*unplaced_.begin()), places_.vehicle));
        if (const std::size_t n = sort_unique_labels(labels_); n > 0)
            result.notes.push_back(
                fmt::format("{} boxes are skipped, because another box has the same track id and the same "
                            "time",
                            n));
        unify_label_properties(labels_);
        result.tracks = build_tracks(labels_);
        return result;
    }

private:
    const BoxPlaces& places_;
    WorldFrames frames_;
    double first_s_, last_s_;
    std::vector<BoxLabel> labels_;
    std::set<std::string> unplaced_;  ///< frames without a known pose
    std::size_t n_unplaced_ = 0;
};

}  // namespace

BoxTracks read_tracks(const Bag& bag, const BoxTopic& boxes, const BoxPlaces& places,
                      const std::vector<double>& times_s) {
    const double step_s = compute_median_step_s(times_s);
    LabelReader reader(places, times_s.front() - step_s, times_s.back() + step_s);
    for (const BoxEntry& entry : boxes.lists)
        if (reader.is_wanted(reader.seconds(entry.stamp_ns, entry.log_ns)))
            reader.add_box_list(read_boxes(bag.topics()[boxes.topic], bag.read(entry.place).bytes),
                                entry.log_ns);
    return reader.tracks();
}

}  // namespace relidar::bag
