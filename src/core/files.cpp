// SPDX-License-Identifier: Apache-2.0
// Reading files whole, and numbers out of their lines.
#include "core/files.hpp"

#include <charconv>
#include <fstream>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {

std::string read_file(const std::filesystem::path& path) {
    std::error_code failed;
    if (!std::filesystem::exists(path, failed)) throw DataError(fmt::format("{}: no such file", path.string()));
    if (!std::filesystem::is_regular_file(path, failed)) throw DataError(fmt::format("{}: not a file", path.string()));
    std::ifstream in(path, std::ios::binary);
    if (!in) throw DataError(fmt::format("{}: cannot be opened for reading", path.string()));
    std::string text(std::filesystem::file_size(path), '\0');
    in.read(text.data(), static_cast<std::streamsize>(text.size()));
    if (in.gcount() != static_cast<std::streamsize>(text.size())) {
        throw DataError(fmt::format("{}: only {} of {} bytes could be read", path.string(), in.gcount(), text.size()));
    }
    return text;
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
