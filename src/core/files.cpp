// SPDX-License-Identifier: Apache-2.0
// Reading files whole, and numbers out of their lines.
#include "core/files.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <fstream>
#include <system_error>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {

namespace fs = std::filesystem;

namespace {

/// Why a path that was looked at is not there or cannot be reached: what the system says.
DataError unreachable(const fs::path& path, const char* thing, const std::error_code& failed) {
    const bool missing = !failed || failed == std::errc::no_such_file_or_directory || failed == std::errc::not_a_directory;
    return DataError(missing ? fmt::format("{}: no such {}", path.string(), thing)
                             : fmt::format("{}: cannot be read: {}", path.string(), failed.message()));
}

}  // namespace

std::string read_file(const fs::path& path) {
    std::error_code failed;
    const fs::file_status status = fs::status(path, failed);
    if (!fs::status_known(status) || !fs::exists(status)) throw unreachable(path, "file", failed);
    if (!fs::is_regular_file(status)) throw DataError(fmt::format("{}: not a file", path.string()));
    std::ifstream in(path, std::ios::binary);
    if (!in) throw DataError(fmt::format("{}: cannot be read: {}", path.string(), std::generic_category().message(errno)));
    const std::uintmax_t n_bytes = fs::file_size(path, failed);
    if (failed) throw unreachable(path, "file", failed);
    std::string text(n_bytes, '\0');
    in.read(text.data(), static_cast<std::streamsize>(text.size()));
    if (in.gcount() != static_cast<std::streamsize>(text.size())) {
        throw DataError(fmt::format("{}: only {} of {} bytes could be read", path.string(), in.gcount(), text.size()));
    }
    return text;
}

std::vector<fs::path> list_folder(const fs::path& folder) {
    std::error_code failed;
    std::vector<fs::path> paths;
    fs::directory_iterator entry(folder, failed);
    if (failed) throw unreachable(folder, "folder", failed);
    for (const fs::directory_iterator end; entry != end; entry.increment(failed)) {
        if (failed) throw unreachable(folder, "folder", failed);
        paths.push_back(entry->path());
    }
    std::sort(paths.begin(), paths.end());
    return paths;
}

std::optional<int> file_number(const std::string& stem) {
    const std::size_t first = std::min(stem.find_first_not_of('0'), stem.size());
    if (stem.empty() || stem.size() - first > 8 || stem.find_first_not_of("0123456789") != std::string::npos) return std::nullopt;
    int number = 0;
    std::from_chars(stem.data(), stem.data() + stem.size(), number);
    return number;
}

std::string excerpt(std::string_view text) {
    constexpr std::size_t kMost = 80;
    const bool cut = text.size() > kMost;
    std::size_t n = cut ? kMost - 3 : text.size();
    while (cut && n > 0 && (static_cast<unsigned char>(text[n]) & 0xC0) == 0x80) --n;   // not within a UTF-8 character
    std::string shown(text.substr(0, n));
    std::replace_if(shown.begin(), shown.end(), [](unsigned char c) { return std::iscntrl(c) != 0; }, '?');
    return cut ? shown + "..." : shown;
}

std::vector<std::string> split_lines(const std::string& text) {
    std::vector<std::string> lines;
    for (std::size_t begin = 0; begin < text.size();) {
        const std::size_t end = std::min(text.find('\n', begin), text.size());
        std::size_t length = end - begin;
        if (length > 0 && text[begin + length - 1] == '\r') --length;
        lines.push_back(text.substr(begin, length));
        begin = end + 1;
    }
    return lines;
}

std::string_view trimmed(std::string_view text) {
    constexpr std::string_view kBlank = " \t\r\n";
    const std::size_t begin = text.find_first_not_of(kBlank);
    if (begin == std::string_view::npos) return {};
    return text.substr(begin, text.find_last_not_of(kBlank) - begin + 1);
}

std::optional<double> parse_number(std::string_view text) {
    if (!text.empty() && text.front() == '+') text.remove_prefix(1);
    double value = 0.0;
    const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (code != std::errc() || end != text.data() + text.size() || text.empty()) return std::nullopt;
    return value;
}

std::optional<std::vector<double>> parse_numbers(std::string_view line) {
    std::vector<double> numbers;
    for (line = trimmed(line); !line.empty(); line = trimmed(line)) {
        const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
        const std::optional<double> number = parse_number(line.substr(0, end));
        if (!number) return std::nullopt;
        numbers.push_back(*number);
        line.remove_prefix(end);
    }
    return numbers;
}

}  // namespace relidar
