// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <tuple>

#include <fmt/format.h>

#include "base/files.hpp"
#include "log/readers/bag/choose.hpp"

namespace relidar::bag {

BoxChoice choose_boxes(const Bag& bag, const Survey& survey) {
    BoxChoice choice;
    const auto name_of = [&](const BoxTopic& boxes) { return bag.topics()[boxes.topic].name; };
    const auto is_worse = [&](const BoxTopic& a, const BoxTopic& b) {
        return a.n_named != b.n_named ? a.n_named < b.n_named : name_of(a) > name_of(b);
    };
    const auto best = std::ranges::max_element(survey.boxes, is_worse);
    if (best != survey.boxes.end() && best->n_named > 0) choice.topic = &*best;
    for (const BoxTopic& boxes : survey.boxes) {
        const std::string name = excerpt(name_of(boxes));
        if (&boxes == choice.topic)
            choice.notes.push_back(fmt::format("boxes are read from {}{}", name,
                                               boxes.n_named == boxes.n_boxes
                                                   ? ""
                                                   : fmt::format("; {} boxes without a track id are skipped",
                                                                 boxes.n_boxes - boxes.n_named)));
        else if (boxes.n_named > 0)
            choice.notes.push_back(fmt::format(
                "the boxes of {} are ignored: {} boxes have a track id, but {} boxes of {} have one", name,
                boxes.n_named, choice.topic->n_named, excerpt(name_of(*choice.topic))));
        else if (boxes.n_boxes > 0)
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored, because none of the {} boxes has a track id", name,
                            boxes.n_boxes));
    }
    for (const Topic& topic : bag.topics())
        if (use_of(topic) == Use::nameless_boxes)
            choice.notes.push_back(
                fmt::format("the boxes of {} are ignored, because messages of type {} have no track ids",
                            excerpt(topic.name), excerpt(topic.type)));
    return choice;
}

}  // namespace relidar::bag
