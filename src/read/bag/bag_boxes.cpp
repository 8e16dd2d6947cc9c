// SPDX-License-Identifier: Apache-2.0
#include "read/bag/choose.hpp"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <relidar/read/clouds.hpp>

#include "base/files.hpp"
#include "log/frames/match_sweeps.hpp"

namespace relidar::bag {
namespace {

constexpr const char* kNoCategory = "unknown";

/// Gives all labels of an object its most frequent category and its median size, because
/// object trackers change them over time.
void unify_labels(std::vector<BoxLabel>& labels) {
    std::map<std::string, std::vector<BoxLabel*>> labels_of_object;
    for (BoxLabel& label : labels) labels_of_object[label.id].push_back(&label);
    for (auto& [id, labels_of_id] : labels_of_object) {
        glm::dvec3 median_size_m;
        for (int axis = 0; axis < 3; ++axis) {
            const auto middle = labels_of_id.begin() + std::ptrdiff_t(labels_of_id.size() / 2);
            std::ranges::nth_element(labels_of_id, middle, {},
                                     [axis](const BoxLabel* label) { return label->size_m[axis]; });
            median_size_m[axis] = (*middle)->size_m[axis];
        }
        std::map<std::string, std::size_t> n_labels_of_category;
        for (const BoxLabel* label : labels_of_id) ++n_labels_of_category[label->category];
        // Any known category is better than none.
        if (n_labels_of_category.size() > 1) n_labels_of_category.erase(kNoCategory);
        const auto n_labels = [](const auto& category_and_count) { return category_and_count.second; };
        const auto most_frequent = std::ranges::max_element(n_labels_of_category, {}, n_labels);
        for (BoxLabel* label : labels_of_id) {
            label->size_m = median_size_m;
            label->category = most_frequent->first;
        }
    }
}

/// Reads the box messages of a topic and converts the boxes to the world frame.
class BoxMessageReader {
public:
    /// @param first_s, last_s  labels outside of these times are ignored
    BoxMessageReader(const BoxContext& context, double first_s, double last_s)
        : context_(context), first_s_(first_s), last_s_(last_s) {}

    bool is_in_log(const MessageTimes& times) const {
        const double time_s = log_time_s(times);
        return time_s >= first_s_ && time_s <= last_s_;
    }

    /// Adds the boxes of a message in the world frame. Ignores boxes outside the log, and
    /// boxes without a track id, which cannot be joined to a track.
    void add_labels(const BoxListMessage& box_list, std::int64_t log_ns) {
        for (const BoxMessage& box : box_list.boxes) {
            const MessageTimes times{box.header.stamp_ns, log_ns};
            if (box.id.empty() || !is_in_log(times)) continue;
            const double t_s = log_time_s(times);
            const std::optional<Pose> world_from_frame = find_pose(box.header.frame, t_s);
            if (!world_from_frame) {
                ++n_unplaced_;
                unplaced_.insert(box.header.frame);
                continue;
            }
            labels_.push_back({box.id, box.category.empty() ? kNoCategory : box.category, box.size_m, t_s,
                               *world_from_frame * box.frame_from_box});
        }
    }

    /// Joins the labels of each object to a track. Adds notes about skipped boxes.
    LoadedBoxes make_tracks() {
        LoadedBoxes result;
        if (n_unplaced_ > 0)
            result.notes.push_back(fmt::format(
                "{} boxes are skipped, because the pose of the frame '{}' in the frame '{}' is unknown",
                n_unplaced_, quote(*unplaced_.begin()), context_.vehicle));
        // Sorts labels by time. Removes repeated labels of an object at the same time.
        std::ranges::stable_sort(labels_, {}, &BoxLabel::time_s);
        std::set<std::pair<std::string, double>> seen;
        const std::size_t n_repeated = std::erase_if(
            labels_, [&](const BoxLabel& label) { return !seen.emplace(label.id, label.time_s).second; });
        if (n_repeated > 0)
            result.notes.push_back(fmt::format(
                "{} boxes are skipped, because another box has the same track id and time", n_repeated));
        unify_labels(labels_);
        result.tracks = build_tracks(labels_);
        return result;
    }

private:
    const BoxContext& context_;
    double first_s_, last_s_;
    /// by frame; null if no transforms connect the frame with the vehicle
    std::map<std::string, std::optional<FramePose>> vehicle_from_frame_;
    std::vector<BoxLabel> labels_;
    std::set<std::string> unplaced_;  ///< frames without a known pose
    std::size_t n_unplaced_ = 0;

    /// Returns the time in the log. A message without a stamp gets its recording time.
    double log_time_s(const MessageTimes& times) const {
        const LogClock clock = times.stamp_ns == 0 ? LogClock::recorder : context_.poses.clock;
        return 1e-9 * double(times.time_ns(clock) - context_.box_zero_ns);
    }

    /// Returns the pose of a coordinate frame in the world frame, or nothing if the bag
    /// does not contain the pose at this time.
    std::optional<Pose> find_pose(const std::string& frame_id, double t_s) {
        const ChosenPoses& poses = context_.poses;
        if (context_.is_world_of_poses && frame_id == poses.world) return Pose{};
        const auto [entry, is_new] = vehicle_from_frame_.try_emplace(frame_id);
        std::optional<FramePose>& vehicle_from_frame = entry->second;
        if (is_new)
            vehicle_from_frame =
                context_.frames.find_chain(context_.vehicle, frame_id, poses.clock, poses.poses_zero_ns);
        if (!vehicle_from_frame || !vehicle_from_frame->covers_time(t_s)) return std::nullopt;
        if (context_.is_world_of_poses && !poses.path->covers_time(t_s)) return std::nullopt;
        return context_.world_from_vehicle(t_s) * vehicle_from_frame->compute_pose_at(t_s);
    }
};

}  // namespace

SelectedBoxTopic choose_boxes(const BagRecording& bag, const BagIndex& index) {
    SelectedBoxTopic choice;
    const auto name_of = [&](const BoxTopic& boxes) { return bag.topics()[boxes.topic].name; };
    const auto best = std::ranges::min_element(index.boxes, {}, [&](const BoxTopic& boxes) {
        return std::pair(-std::ptrdiff_t(boxes.n_named), name_of(boxes));
    });
    if (best != index.boxes.end() && best->n_named > 0) choice.topic = &*best;

    for (const BoxTopic& boxes : index.boxes) {
        const std::string name = quote(name_of(boxes));
        if (&boxes == choice.topic) {
            const std::size_t n_skipped = boxes.n_boxes - boxes.n_named;
            choice.notes.push_back(
                "boxes are read from " + name +
                (n_skipped == 0 ? "" : fmt::format("; {} boxes without a track id are skipped", n_skipped)));
        } else if (boxes.n_named > 0) {
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored: {} of them have a track id, but relidar reads "
                            "boxes from only one topic, {}, where {} boxes have one",
                            name, boxes.n_named, quote(name_of(*choice.topic)), choice.topic->n_named));
        } else if (boxes.n_boxes > 0) {
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored, because none of the {} boxes has a track id", name,
                            boxes.n_boxes));
        }
    }
    for (const BagTopic& topic : bag.topics())
        if (find_purpose(topic) == MessagePurpose::nameless_boxes)
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored, because messages of type {} have no track ids",
                            quote(topic.name), quote(topic.type)));
    return choice;
}

LoadedBoxes read_bag_boxes(const BagRecording& bag, const BoxTopic& box_topic, const BoxContext& context,
                           const std::vector<double>& times_s) {
    const double step_s = median_interval_s(times_s);
    BoxMessageReader reader(context, times_s.front() - step_s, times_s.back() + step_s);
    const BagTopic& topic = bag.topics()[box_topic.topic];
    for (const BoxIndexEntry& entry : box_topic.lists)
        if (reader.is_in_log(entry)) {
            const SharedBytes message = bag.read_message(topic, entry.message_position);
            reader.add_labels(read_boxes(topic, message.bytes), entry.log_ns);
        }
    return reader.make_tracks();
}

}  // namespace relidar::bag
