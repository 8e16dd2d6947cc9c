// SPDX-License-Identifier: Apache-2.0
#include "read/bag/survey.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/files.hpp"
#include "read/bag/packet_messages.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kMostLines = 40;
// If a time step is longer than this multiple of the usual step, a sweep is missing.
constexpr double kMinGapSteps = 1.6;
// Time stamps have jumped if time stamp minus recording time changes by more than this.
constexpr double kMinJump_s = 0.5;

/// Describes the clouds of a topic, or the packets from which clouds are decoded.
std::string describe_content(const CloudTopic& cloud_topic) {
    if (!cloud_topic.packets.empty()) {
        std::size_t n_missing = 0;
        for (const packets::PacketRevolution& revolution : cloud_topic.packets.revolutions())
            n_missing += revolution.n_missing;
        const std::string problems = cloud_topic.packets.describe_faults();
        return fmt::format(
            ", frame '{}', {} packets of a {}: {} full revolutions{}{}{}", quote(cloud_topic.frame),
            cloud_topic.packets.size(), cloud_topic.packets.describe_product(),
            cloud_topic.packets.revolutions().size(),
            n_missing == 0 ? ""
                           : fmt::format("; {} packets are missing, and their rays are left out", n_missing),
            problems.empty() ? "" : "; ", problems);
    }
    std::vector<std::string> names;
    for (const CloudMessage::CloudField& field : cloud_topic.fields)
        names.push_back(fmt::format("{} {}{}", quote(field.name), field.kind, 8 * field.size));
    return fmt::format(", frame '{}', {} points, fields {}", quote(cloud_topic.frame),
                       cloud_topic.median_points(), fmt::join(names, " "));
}

// The following functions describe topic `t`, or return "" if it has other content.

/// Describes the clouds of all LiDARs of a topic.
std::string describe_clouds(const BagRecording& bag, const BagIndex& index, std::size_t t) {
    const auto clouds = std::ranges::find(index.clouds, t, &CloudTopic::topic);
    if (clouds == index.clouds.end()) return "";
    std::string text = describe_content(*clouds);
    const auto n_lidars = std::ranges::count(index.clouds, t, &CloudTopic::topic);
    if (n_lidars > 1)
        text += fmt::format(", clouds of {} LiDARs, which are read as '{}' and so on", n_lidars,
                            quote(clouds->make_name(bag)));
    if (clouds->n_empty > 0) text += fmt::format(", {} clouds without points", clouds->n_empty);
    return text;
}

std::string describe_poses(const BagIndex& index, std::size_t t) {
    const auto poses = std::ranges::find(index.poses, t, &PoseTopic::topic);
    if (poses == index.poses.end()) return "";
    return fmt::format(", frame '{}' in '{}'", poses->child.empty() ? "unknown" : quote(poses->child),
                       quote(poses->parent));
}

std::string describe_boxes(const BagIndex& index, std::size_t t) {
    const auto boxes = std::ranges::find(index.boxes, t, &BoxTopic::topic);
    if (boxes == index.boxes.end()) return "";
    std::string text = fmt::format(", frame '{}', {} boxes, {} with a track id", quote(boxes->frame),
                                   boxes->n_boxes, boxes->n_named);
    if (boxes->n_left_out != 0)
        text += fmt::format("; {} more boxes have no size or no pose", boxes->n_left_out);
    return text;
}

}  // namespace

std::vector<std::string> describe_topics(const BagRecording& bag, const BagIndex& index,
                                         const std::vector<bool>& is_topic_used) {
    std::vector<std::string> lines;
    for (std::size_t t = 0; t < bag.topics().size() && lines.size() < kMostLines; ++t) {
        const BagTopic& topic = bag.topics()[t];
        const TopicStatistics& facts = index.facts[t];
        std::string line = fmt::format("topic {}: {}", quote(topic.name), quote(topic.type));
        // The messages of a network capture are groups of packets that the reader makes.
        const bool has_messages = topic.type != kLidarDatagrams;
        if (has_messages) line += fmt::format(", {} messages", facts.n);
        if (has_messages && facts.rate_hz() > 0.0) line += fmt::format(", {:.1f} Hz", facts.rate_hz());
        line += describe_clouds(bag, index, t);
        line += describe_poses(index, t);
        line += describe_boxes(index, t);
        if (facts.n_broken > 0)
            line += fmt::format(", {} messages cannot be read (the first error: {})", facts.n_broken,
                                facts.broken);
        if (facts.n_left_out > 0)
            line += fmt::format(", {} poses are left out (the first {})", facts.n_left_out, facts.left_out);
        lines.push_back(line + (is_topic_used[t] ? ": used" : ""));
    }
    if (bag.topics().size() > kMostLines)
        lines.push_back(fmt::format("{} more topics", bag.topics().size() - kMostLines));
    return lines;
}

std::string describe_gaps(const std::vector<double>& sweep_times_s, double sweep_period_s) {
    std::size_t n_gaps = 0;
    double n_missing = 0.0, longest_s = 0.0, begin_of_longest_s = 0.0;
    for (std::size_t i = 1; i < sweep_times_s.size(); ++i) {
        const double gap_s = sweep_times_s[i] - sweep_times_s[i - 1];
        if (gap_s < kMinGapSteps * sweep_period_s) continue;
        ++n_gaps;
        // n - 1 sweeps are missing in a gap of n periods.
        n_missing += std::round(gap_s / sweep_period_s) - 1.0;
        if (gap_s > longest_s) {
            longest_s = gap_s;
            begin_of_longest_s = sweep_times_s[i - 1];
        }
    }
    if (n_gaps == 0) return "";
    return fmt::format("{} gaps with about {} missing sweeps; the longest gap is {:.2f} s, at {:.2f} s",
                       n_gaps, n_missing, longest_s, begin_of_longest_s);
}

std::string describe_frame_ids(const CloudTopic& cloud_topic) {
    if (cloud_topic.n_other_frame == 0) return "";
    return fmt::format(
        "{} clouds have another frame than the first cloud, for example '{}'; all count as '{}'",
        cloud_topic.n_other_frame, quote(cloud_topic.other_frame), quote(cloud_topic.frame));
}

std::string describe_jumps(const CloudTopic& cloud_topic) {
    std::size_t n_not_later = 0, n_jumps = 0;
    double largest_s = 0.0;
    for (std::size_t i = 1; i < cloud_topic.clouds.size(); ++i) {
        const CloudEntry &before = cloud_topic.clouds[i - 1], &entry = cloud_topic.clouds[i];
        if (entry.stamp_ns <= before.stamp_ns) ++n_not_later;
        // Difference between the steps of the time stamps and of the recorder's clock.
        const double jump_s =
            1e-9 * (double(entry.stamp_ns - before.stamp_ns) - double(entry.log_ns - before.log_ns));
        if (std::abs(jump_s) < kMinJump_s) continue;
        ++n_jumps;
        if (std::abs(jump_s) > std::abs(largest_s)) largest_s = jump_s;
    }
    std::string text;
    if (n_not_later > 0)
        text = fmt::format("the stamps of {} clouds are not later than the previous stamp", n_not_later);
    if (n_jumps > 0)
        text += fmt::format("{}the clock of the stamps jumps {} times, by at most {:.2f} s",
                            text.empty() ? "" : "; ", n_jumps, std::abs(largest_s));
    return text;
}

}  // namespace relidar::bag
