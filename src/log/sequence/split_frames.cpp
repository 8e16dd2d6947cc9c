// SPDX-License-Identifier: Apache-2.0
// Selects the test frames, which do not train the scene (paper Sec. 4): every n-th frame,
// the frames of a published split, or the frames in a list.
#include <relidar/log/sequence.hpp>

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
constexpr const char* kSetting = "dataset.test_frames";

/// Parses a frame number such as "13" or a range such as "40:45" to [first, end).
std::pair<int, int> parse_frame_range(std::string_view text) {
    const std::size_t colon = text.find(':');
    const std::optional<int> first = parse_file_stem_as_number(std::string(text.substr(0, colon)));
    const std::optional<int> end = colon == std::string_view::npos
                                       ? first.value_or(0) + 1
                                       : parse_file_stem_as_number(std::string(text.substr(colon + 1)));
    if (!first || !end || *first >= *end)
        fail<UsageError>("{}: found \"{}\", expected frame numbers or FIRST:END, for example 13,26,40:45",
                         kSetting, shorten_for_error_message(text));
    return {*first, *end};
}

/// Selects every n-th frame for testing, but not the first frame.
std::set<int> select_every_nth_frame(int test_every, const std::vector<int>& frame_numbers) {
    if (test_every < 0 || test_every == 1)
        fail<UsageError>("dataset.test_every is {}, expected 0 (no frame is held out) or at least 2",
                         test_every);
    std::set<int> held_out;
    for (auto i = std::size_t(test_every); test_every > 0 && i < frame_numbers.size();
         i += std::size_t(test_every))
        held_out.insert(frame_numbers[i]);
    return held_out;
}

/// Parses a list of frame indices and ranges, for example "13,26,40:45".
std::set<int> parse_test_frame_list(const std::string& frame_list_text,
                                    const std::vector<int>& log_frame_numbers) {
    const std::set<int> log_frames(log_frame_numbers.begin(), log_frame_numbers.end());
    std::set<int> held_out;
    for (const std::string_view cell : split_csv_cells(frame_list_text)) {
        const auto [first, end] = parse_frame_range(cell);
        for (int index = first; index < end; ++index) {
            if (!log_frames.contains(index))
                fail<UsageError>("{}: found frame {}, expected some of the frames {}", kSetting, index,
                                 format_number_list(log_frame_numbers));
            if (!held_out.insert(index).second)
                fail<UsageError>("{}: frame {} occurs twice, expected it once", kSetting, index);
        }
    }
    if (held_out.size() == log_frames.size())
        fail<UsageError>("{}: all frames of the log are held out, expected fewer: {}", kSetting,
                         format_number_list(log_frame_numbers));
    return held_out;
}

}  // namespace

TrainTestSplit split_frames_into_train_and_test(const LidarSequence& sequence, int test_every_nth_frame,
                                                const std::string& test_frame_list) {
    std::vector<int> sweeps;  // several LiDARs can have a frame with the same index
    std::set<int> added_numbers;
    for (const LidarFrame& frame : sequence.frames)
        if (added_numbers.insert(frame.index).second) sweeps.push_back(frame.index);
    const std::vector<int>& published_test_frames = sequence.test_frames;
    std::set<int> held_out;
    if (!test_frame_list.empty()) held_out = parse_test_frame_list(test_frame_list, sweeps);
    else if (test_every_nth_frame == kPublishedEvery && !published_test_frames.empty()) {
        for (const int index : sweeps)
            if (std::ranges::find(published_test_frames, index) != published_test_frames.end())
                held_out.insert(index);
    } else held_out = select_every_nth_frame(test_every_nth_frame, sweeps);
    TrainTestSplit split;
    for (int i = 0; i < static_cast<int>(sequence.frames.size()); ++i)
        (held_out.contains(sequence.frames[std::size_t(i)].index) ? split.test : split.train).push_back(i);
    return split;
}

}  // namespace relidar
