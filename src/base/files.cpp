// SPDX-License-Identifier: Apache-2.0
// Reads complete files, splits them into lines and parses numbers.
#include "base/files.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <fstream>
#include <system_error>

#include "base/fail.hpp"
#include "base/number_text.hpp"

namespace relidar {

namespace fs = std::filesystem;

namespace {

constexpr std::string_view kBlanks = " \t\r\n";

DataError unreadable(const fs::path& path, const std::error_code& system_error) {
    return DataError(fmt::format("cannot read {}: {}", path.string(), system_error.message()));
}

fs::file_status status_of(const fs::path& path) {
    std::error_code failed;
    const fs::file_status status = fs::status(path, failed);
    if (fs::status_known(status)) return status;
    throw unreadable(path, failed);
}

}  // namespace

/// Returns all bytes of a regular file.
/// @throws DataError with the path if it is missing, another kind of file or unreadable
std::string read_file(const fs::path& path) {
    const fs::file_status status = status_of(path);
    if (!fs::exists(status)) fail("{}: no such file", path.string());
    if (!fs::is_regular_file(status)) fail("{}: the path is not a regular file", path.string());
    std::ifstream in(path, std::ios::binary);
    if (!in) throw unreadable(path, {errno, std::generic_category()});
    std::error_code failed;
    const std::uintmax_t n_bytes = fs::file_size(path, failed);
    if (failed) throw unreadable(path, failed);
    std::string text(n_bytes, '\0');
    in.read(text.data(), static_cast<std::streamsize>(text.size()));
    if (in.gcount() != static_cast<std::streamsize>(text.size())) {
        fail("cannot read {}: only {} of {} bytes could be read", path.string(), in.gcount(), text.size());
    }
    return text;
}

std::string read_text_file(const fs::path& path) {
    std::string text = read_file(path);
    if (text.starts_with("\xEF\xBB\xBF")) text.erase(0, 3);
    if (text.starts_with("\xFF\xFE") || text.starts_with("\xFE\xFF"))
        fail("{}: found text in UTF-16, expected UTF-8", path.string());
    return text;
}

std::string file_name_of(const fs::path& path) {
    if (path.empty()) return "";
    return (fs::absolute(path) / "").lexically_normal().parent_path().filename().string();
}

bool does_path_exist(const fs::path& path) { return fs::exists(status_of(path)); }

void require_folder(const fs::path& path, const std::string& expected_description) {
    const fs::file_status status = status_of(path);
    if (!fs::is_directory(status))
        fail("{}: {}, expected {}", path.string(),
             fs::exists(status) ? "the path is not a folder" : "no such folder", expected_description);
}

/// Returns the paths of all entries of a folder, sorted by name.
std::vector<fs::path> list_folder(const fs::path& folder) {
    std::error_code failed;
    std::vector<fs::path> paths;
    if (!fs::is_directory(status_of(folder))) fail("{}: no such folder", folder.string());
    // increment() reports errors in `failed`, while a range-based loop would throw.
    for (fs::directory_iterator entry(folder, failed), end; !failed && entry != end; entry.increment(failed))
        paths.push_back(entry->path());
    if (failed) throw unreadable(folder, failed);
    std::sort(paths.begin(), paths.end());
    return paths;
}

std::optional<int> parse_stem(const std::string& file_stem) {
    const std::size_t first = std::min(file_stem.find_first_not_of('0'), file_stem.size());
    if (file_stem.empty() || file_stem.size() - first > 8 ||
        file_stem.find_first_not_of("0123456789") != std::string::npos)
        return std::nullopt;
    return parse_integer<int>(file_stem);
}

std::string quote(std::string_view text) {
    constexpr std::size_t kMaxQuotedBytes = 80;
    constexpr std::string_view kEllipsis = "...";
    const bool is_too_long = text.size() > kMaxQuotedBytes;
    if (is_too_long) {
        std::size_t end = kMaxQuotedBytes - kEllipsis.size();
        // Does not split a UTF-8 character, whose further bytes are 10xxxxxx.
        while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0) == 0x80) --end;
        text = text.substr(0, end);
    }
    std::string result(text);
    std::replace_if(
        result.begin(), result.end(), [](unsigned char character) { return std::iscntrl(character) != 0; },
        '?');
    if (is_too_long) result += kEllipsis;
    return result;
}

/// Returns the lines of a text without their ends, which are "\n" or "\r\n".
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

std::string_view trim(std::string_view text) {
    const std::size_t begin = text.find_first_not_of(kBlanks);
    if (begin == std::string_view::npos) return {};
    return text.substr(begin, text.find_last_not_of(kBlanks) - begin + 1);
}

std::optional<double> parse_number(std::string_view text) {
    if (!text.empty() && text.front() == '+') text.remove_prefix(1);
    double value = 0.0;
    const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (code != std::errc() || end != text.data() + text.size() || text.empty()) return std::nullopt;
    return value;
}

/// Parses numbers with blanks between them. Returns nullopt if a word is not a number.
std::optional<std::vector<double>> parse_numbers(std::string_view text) {
    std::vector<double> numbers;
    for (text = trim(text); !text.empty(); text = trim(text)) {
        const std::size_t word_end = std::min(text.find_first_of(kBlanks), text.size());
        const std::optional<double> number = parse_number(text.substr(0, word_end));
        if (!number) return std::nullopt;
        numbers.push_back(*number);
        text.remove_prefix(word_end);
    }
    return numbers;
}

}  // namespace relidar
