// SPDX-License-Identifier: Apache-2.0
#include "batch/logs.hpp"

#include <algorithm>
#include <cctype>
#include <iterator>

#include <fmt/format.h>
#include <glob.h>

#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

NamedLog named(const std::string& log, const fs::path& path, std::size_t first_part) {
    std::string name;
    std::size_t part = 0;
    for (const fs::path& piece : path)
        if (part++ >= first_part && !piece.empty()) name += (name.empty() ? "" : "-") + piece.string();
    if (name.ends_with(".tfrecord")) name.resize(name.size() - std::string(".tfrecord").size());
    return {log, as_name(name)};
}

std::size_t parts_of(const fs::path& path) { return static_cast<std::size_t>(std::distance(path.begin(), path.end())); }

/// Position of the part of a path that begins at or holds a character.
std::size_t part_at(const std::string& path, std::size_t position) {
    const std::size_t slash = path.substr(0, position).rfind('/');
    return slash == std::string::npos ? 0 : parts_of(fs::path(path.substr(0, slash + 1))) - 1;
}

/// A path that matches itself alone.
std::string as_pattern(const std::string& path) {
    std::string pattern;
    for (const char c : path) pattern += (std::string("*?[\\").find(c) != std::string::npos ? "\\" : "") + std::string(1, c);
    return pattern;
}

std::vector<std::string> matches(const std::string& pattern) {
    glob_t found{};
    std::vector<std::string> paths;
    if (::glob(pattern.c_str(), 0, nullptr, &found) == 0) paths.assign(found.gl_pathv, found.gl_pathv + found.gl_pathc);
    ::globfree(&found);
    return paths;
}

}  // namespace

std::vector<NamedLog> find_logs(const std::string& text, bool may_be_pattern, const fs::path& folder) {
    const std::size_t colon = text.find(':');
    const std::size_t begin = colon != std::string::npos && text.find('/') > colon ? colon + 1 : 0;
    const std::string kind = text.substr(0, begin), pattern = text.substr(begin);
    const std::size_t wildcard = may_be_pattern ? pattern.find_first_of("*?[") : std::string::npos;
    if (wildcard == std::string::npos) {
        const fs::path path = (fs::path(pattern) / "").lexically_normal().parent_path();   // without a slash at the end
        return {named(text, path, std::max<std::size_t>(parts_of(path), 1) - 1)};
    }
    const std::string root = fs::path(pattern).is_relative() ? folder.string() + "/" : "";
    std::vector<NamedLog> logs;
    for (const std::string& match : matches(as_pattern(root) + pattern)) {
        const std::string path = match.substr(root.size());
        logs.push_back(named(kind + path, path, part_at(pattern, wildcard)));
    }
    if (logs.empty()) throw UsageError(fmt::format("key logs: nothing matches \"{}\", expected logs", pattern.substr(0, 80)));
    return logs;
}

std::string as_name(std::string text) {
    std::replace_if(text.begin(), text.end(),
                    [](unsigned char c) { return std::isalnum(c) == 0 && c != '_' && c != '-' && c != '.'; }, '_');
    return text;
}

}  // namespace relidar::cli
