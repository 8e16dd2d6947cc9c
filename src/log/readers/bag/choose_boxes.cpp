// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <tuple>

#include <fmt/format.h>

#include "base/files.hpp"
#include "log/readers/bag/choose.hpp"

namespace relidar::bag {

SelectedBoxTopic choose_box_topic(const BagRecording& bag, const BagIndex& bag_index) {
    SelectedBoxTopic choice;
    const auto get_name = [&](const BoxTopic& boxes) { return bag.topics()[boxes.topic].name; };
    const auto is_worse = [&](const BoxTopic& first, const BoxTopic& second) {
        return first.n_named != second.n_named ? first.n_named < second.n_named
                                               : get_name(first) > get_name(second);
    };
    const auto best = std::ranges::max_element(bag_index.boxes, is_worse);
    if (best != bag_index.boxes.end() && best->n_named > 0) choice.topic = &*best;
    for (const BoxTopic& boxes : bag_index.boxes) {
        const std::string name = shorten_for_error_message(get_name(boxes));
        if (&boxes == choice.topic)
            choice.notes.push_back(fmt::format("boxes are read from {}{}", name,
                                               boxes.n_named == boxes.n_boxes
                                                   ? ""
                                                   : fmt::format("; {} boxes without a track id are skipped",
                                                                 boxes.n_boxes - boxes.n_named)));
        else if (boxes.n_named > 0)
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored: {} of them have a track id, but relidar reads "
                            "boxes from only one topic, {}, where {} boxes have one",
                            name, boxes.n_named, shorten_for_error_message(get_name(*choice.topic)),
                            choice.topic->n_named));
        else if (boxes.n_boxes > 0)
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored, because none of the {} boxes has a track id", name,
                            boxes.n_boxes));
    }
    for (const BagTopic& topic : bag.topics())
        if (get_message_purpose_of_topic(topic) == MessagePurpose::nameless_boxes)
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored, because messages of type {} have no track ids",
                            shorten_for_error_message(topic.name), shorten_for_error_message(topic.type)));
    return choice;
}

}  // namespace relidar::bag
