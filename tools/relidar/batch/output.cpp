// SPDX-License-Identifier: Apache-2.0
#include "batch/output.hpp"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string_view>

#include <fmt/format.h>

#include "batch/state.hpp"
#include "console.hpp"
#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kTail = 4096;   // bytes from the end of a log that hold its last lines

/// The end of what stands behind a place.
std::string tail(const fs::path& log, std::uintmax_t begin) {
    std::error_code failed;
    const std::uintmax_t size = fs::file_size(log, failed);
    if (failed || size <= begin) return "";
    std::ifstream in(log, std::ios::binary);
    in.seekg(static_cast<std::streamoff>(std::max(begin, size - std::min(size, kTail))));
    return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

std::uintmax_t begin_log(const fs::path& log, const std::vector<std::string>& words) {
    std::string line = "$ relidar";
    for (const std::string& word : words) line += " " + shell_word(word);
    std::ofstream out(log, std::ios::binary | std::ios::app);
    out << line << "   # " << utc_now() << "\n" << std::flush;
    if (!out) throw DataError(fmt::format("{}: cannot be written: the disk is full or the folder has gone", log.string()));
    return fs::file_size(log);
}

std::string last_line(const fs::path& log, std::uintmax_t begin) {
    const std::string text = tail(log, begin);
    const std::size_t end = text.rfind('\n');
    if (end == std::string::npos || end == 0) return "";
    const std::size_t before = text.rfind('\n', end - 1);
    return one_line(text.substr(before + 1, end - before - 1));   // npos + 1 is 0
}

std::string error_line(const fs::path& log, std::uintmax_t begin) {
    constexpr std::string_view kOurs = "relidar: ", kNote = "relidar: note: ";
    std::istringstream lines(tail(log, begin));
    std::string found;
    for (std::string line; std::getline(lines, line);)
        if (line.starts_with(kOurs) && !line.starts_with(kNote)) found = one_line(line.substr(kOurs.size()));
    return found;
}

}  // namespace relidar::cli
