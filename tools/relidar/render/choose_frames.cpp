// SPDX-License-Identifier: Apache-2.0
#include "render/choose_frames.hpp"

#include <numeric>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

std::vector<int> all_frames(const Run& run) {
    std::vector<int> positions(run.sequence.frames.size());
    std::iota(positions.begin(), positions.end(), 0);
    return positions;
}

}  // namespace

std::vector<int> select_frames(const Run& run, const std::optional<std::string>& frames_text, bool quiet) {
    if (!frames_text && run.split.test.empty()) {
        if (!quiet)
            print_note(fmt::format("{} has no held-out frames, so all {} frames are rendered instead",
                                   run.folder.string(), run.sequence.frames.size()));
        return all_frames(run);
    }
    const std::string which = frames_text.value_or("test");
    // Empty for a range of frame numbers.
    const std::string name = find_name(which, {"test", "train", "all"}).value_or("");
    std::vector<int> positions;
    if (name == "all") positions = all_frames(run);
    else positions = name == "train" ? run.split.train : run.split.test;
    const int last = run.sequence.frames.back().index;
    if (name.empty()) {
        const FrameRange range = parse_frames(which);
        positions = all_frames(run);
        std::erase_if(positions, [&](int i) {
            const int index = run.sequence.frames[static_cast<std::size_t>(i)].index;
            return index < range.begin || (range.end >= 0 && index >= range.end);
        });
        if (!positions.empty()) note_missing_frames(range, last, run.folder.string());
    }
    if (positions.empty()) {
        fail<UsageError>(
            "--frames {} selects no frame of {}; expected frame numbers from {} to {}, or test, train or all",
            which, run.folder.string(), run.sequence.frames.front().index, last);
    }
    return positions;
}

}  // namespace relidar::cli
