// SPDX-License-Identifier: Apache-2.0
// Selects the test frames, which do not train the scene (paper Sec. 4): every n-th frame,
// the frames of a published split, or the frames in a list.
#include <relidar/log/log.hpp>

#include <algorithm>
#include <optional>
#include <set>
#include <string_view>

#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/list_text.hpp"

namespace relidar {
namespace {

// If every 10th frame is requested (the default), the published split of the dataset is
// used instead, if one exists.
constexpr int kPublishedEvery = 10;
constexpr const char* kTestFramesSetting = "dataset.test_frames";

/// Parses a frame number such as "13" or a range such as "40:45" to [first, end).
std::pair<int, int> parse_frames(std::string_view text) {
    const std::size_t colon = text.find(':');
    const bool is_range = colon != std::string_view::npos;
    const std::optional<int> first = parse_stem(std::string(text.substr(0, colon)));
    std::optional<int> end = is_range ? parse_stem(std::string(text.substr(colon + 1))) : first;
    if (end && !is_range) ++*end;
    if (!first || !end || *first >= *end)
        fail<UsageError>("{}: found \"{}\", expected frame numbers or FIRST:END, for example 13,26,40:45",
                         kTestFramesSetting, quote(text));
    return {*first, *end};
}

/// Selects every n-th frame for testing, but not the first frame.
std::set<int> select_nth_frames(int test_every, const std::vector<int>& numbers) {
    if (test_every < 0 || test_every == 1)
        fail<UsageError>("dataset.test_every is {}, expected 0 (no frame is held out) or at least 2",
                         test_every);
    std::set<int> held_out;
    for (auto i = std::size_t(test_every); test_every > 0 && i < numbers.size(); i += std::size_t(test_every))
        held_out.insert(numbers[i]);
    return held_out;
}

/// Parses a list of numbers and ranges of test frames, for example "13,26,40:45". Each
/// must be a frame of the log and occur once, and a frame must remain for training.
std::set<int> parse_frame_list(const std::string& text, const std::vector<int>& log_frame_numbers) {
    const std::set<int> log_frames(log_frame_numbers.begin(), log_frame_numbers.end());
    std::set<int> held_out;
    for (const std::string_view cell : split_csv_cells(text)) {
        const auto [first, end] = parse_frames(cell);
        for (int index = first; index < end; ++index) {
            if (!log_frames.contains(index))
                fail<UsageError>("{}: found frame {}, expected some of the frames {}", kTestFramesSetting,
                                 index, list_text(log_frame_numbers));
            if (!held_out.insert(index).second)
                fail<UsageError>("{}: frame {} occurs twice, expected it once", kTestFramesSetting, index);
        }
    }
    if (held_out.size() == log_frames.size())
        fail<UsageError>("{}: all frames of the log are held out, expected fewer: {}", kTestFramesSetting,
                         list_text(log_frame_numbers));
    return held_out;
}

}  // namespace

Split split_frames(const Log& log, int test_every_nth_frame, const std::string& test_frame_list) {
    std::vector<int> sweeps;  // numbers of all frames; LiDARs of the same sweep share a number
    std::set<int> added_numbers;
    for (const Frame& frame : log.frames)
        if (added_numbers.insert(frame.index).second) sweeps.push_back(frame.index);
    std::set<int> held_out;
    // Precedence: the list of the user, the published split, every n-th frame.
    if (!test_frame_list.empty()) held_out = parse_frame_list(test_frame_list, sweeps);
    else if (test_every_nth_frame == kPublishedEvery && !log.test_frames.empty())
        held_out = {log.test_frames.begin(), log.test_frames.end()};
    else held_out = select_nth_frames(test_every_nth_frame, sweeps);
    Split split;
    for (int i = 0; i < static_cast<int>(log.frames.size()); ++i) {
        const bool is_test = held_out.contains(log.frames[std::size_t(i)].index);
        if (is_test) split.test.push_back(i);
        else split.train.push_back(i);
    }
    return split;
}

}  // namespace relidar
