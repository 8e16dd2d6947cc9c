// SPDX-License-Identifier: Apache-2.0
#include "rules.hpp"

#include <algorithm>
#include <map>
#include <set>
#include <sstream>

namespace relidar::structure {
namespace {

constexpr int kFunctionLines = 60;
constexpr int kArguments = 7;
constexpr std::size_t kCodeColumns = 110;
constexpr std::size_t kCommentColumns = 90;

const std::set<std::string> kCompositionRoots = {"src/train/train.cpp", "tools/relidar/main.cpp"};

/// Returns the maximum number of lines of a file, or 0 if the file has no limit.
int get_line_limit(const std::string& path) {
    if (kCompositionRoots.contains(path)) return 180;
    if (path.starts_with("include/relidar/")) return 420;
    if (path.starts_with("shaders/") && has_extension(path, {".h"})) return 165;
    if (has_extension(path, {".comp"})) return 220;
    if (has_extension(path, {".cpp", ".hpp", ".h", ".glsl", ".cmake"})) return 550;
    return 0;
}

/// Returns the number of UTF-8 characters in a line.
std::size_t columns_of(const std::string& line) {
    return static_cast<std::size_t>(std::count_if(line.begin(), line.end(), [](char character) {
        return (static_cast<unsigned char>(character) & 0xc0) != 0x80;
    }));
}

/// Returns the limit of columns that a line exceeds, or 0. Literals may be longer than
/// code. Comment lines that are indented by two or more spaces (tables, equations) may be
/// as long as code.
std::size_t count_exceeded_columns(const std::string& text, const std::string& code) {
    const std::size_t columns = columns_of(text), first = text.find_first_not_of(' ');
    if (first != std::string::npos && text.compare(first, 2, "//") == 0) {
        const std::size_t body = text.find_first_not_of("/<!", first);
        const bool is_table = body != std::string::npos && text.compare(body, 3, "   ") == 0;
        const std::size_t limit = is_table ? kCodeColumns : kCommentColumns;
        return columns > limit ? limit : 0;
    }
    const bool is_code = code.find_first_not_of(" )\";,}", kCodeColumns) != std::string::npos;
    return columns > kCodeColumns && is_code ? kCodeColumns : 0;
}

}  // namespace

Violations check_budgets(const SourceTree& tree) {
    Violations violations;
    for (const auto& [path, file] : tree) {
        const int limit = get_line_limit(path);
        if (limit == 0) continue;
        const int n_lines = static_cast<int>(file.lines.size());
        if (n_lines > limit)
            violations.push_back(path + ":1: " + std::to_string(n_lines) + " lines, at most " +
                                 std::to_string(limit));
        if (has_extension(path, {".cmake"})) continue;
        std::istringstream code_lines(file.code);
        std::string code;
        for (std::size_t i = 0; i < file.lines.size() && std::getline(code_lines, code); ++i)
            if (const std::size_t most = count_exceeded_columns(file.lines[i], code))
                violations.push_back(path + ":" + std::to_string(i + 1) + ": " +
                                     std::to_string(columns_of(file.lines[i])) + " columns, at most " +
                                     std::to_string(most));
        for (const Function& function : list_functions(file)) {
            const std::string where = path + ":" + std::to_string(function.first_line) + ": " + function.name;
            if (function.has_body && function.n_lines() > kFunctionLines) {
                violations.push_back(where + " has " + std::to_string(function.n_lines()) +
                                     " lines, at most " + std::to_string(kFunctionLines));
            }
            if (function.n_arguments > kArguments) {
                violations.push_back(where + " takes " + std::to_string(function.n_arguments) +
                                     " arguments, at most " + std::to_string(kArguments) + ", then a struct");
            }
        }
    }
    return violations;
}

Violations check_file_names(const SourceTree& tree) {
    Violations violations;
    std::map<std::string, std::string> rooms;  // of the first file of each name
    for (const auto& [path, file] : tree) {
        if (!path.starts_with("src/") || !has_extension(path, {".cpp", ".hpp"})) continue;
        const std::string room = path.substr(4, path.find('/', 4) - 4);
        const std::string name = path.substr(path.rfind('/') + 1);
        const auto [first, is_new] = rooms.try_emplace(name, room);
        if (!is_new && first->second != room)
            violations.push_back(path + ":1: the room " + first->second + " has a file of this name, too");
    }
    return violations;
}

}  // namespace relidar::structure
