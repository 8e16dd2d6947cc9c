// SPDX-License-Identifier: Apache-2.0
#include <map>
#include <regex>

#include "rules.hpp"

namespace relidar::structure {
namespace {

bool has_file_with_word(const SourceTree& tree, const std::string& prefix,
                        const std::vector<std::string>& extensions, const std::string& word) {
    for (auto it = tree.lower_bound(prefix); it != tree.end() && it->first.starts_with(prefix); ++it) {
        const SourceFile& file = it->second;
        if (file.path.starts_with("tests/structure/") || !has_extension(file.path, extensions)) continue;
        if (stem(file.path).starts_with(word) || contains_word(file.text, word)) return true;
    }
    return false;
}

bool has_folder(const SourceTree& tree, const std::string& prefix) {
    const auto it = tree.lower_bound(prefix);
    return it != tree.end() && it->first.starts_with(prefix);
}

}  // namespace

Violations check_kernels(const SourceTree& tree) {
    Violations violations;
    const auto readme = tree.find("shaders/README.md");
    for (const auto& [path, file] : tree) {
        if (folder(path, 0) != "shaders" || !has_extension(path, {".comp"})) continue;
        // without "shaders/" and ".comp"
        const std::string name = path.substr(8, path.size() - 8 - 5), word = stem(path);
        const std::string kernel_folder = name.substr(0, name.rfind('/'));
        if (!has_file_with_word(tree, "src/" + kernel_folder + "/", {".cpp"}, word))
            violations.push_back(path + ":1: no binding: '" + word + "' occurs in no .cpp of src/" +
                                 kernel_folder);
        const bool has_tests = has_folder(tree, "tests/" + kernel_folder + "/");
        if (!has_file_with_word(tree, has_tests ? "tests/" + kernel_folder + "/" : "tests/", {".cpp"}, word))
            violations.push_back(path + ":1: no test: '" + word + "' occurs in no .cpp of tests" +
                                 (has_tests ? "/" + kernel_folder : ""));
        if (readme == tree.end() || !contains_word(readme->second.text, name))
            violations.push_back(path + ":1: no row '" + name + "' in shaders/README.md");
    }
    return violations;
}

Violations check_bare_pointers(const SourceTree& tree) {
    static const std::regex begin(R"(struct (\w+) \{.*)"),
        member(R"(    (Floats|Uints|U?[Vv]ec\ds) (\w+);.*)");
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (!has_extension(path, {".h"}) ||
            !(path.starts_with("shaders/") || path.starts_with("include/relidar/")))
            continue;
        // maps each pointer type to the first pointer of this type in the struct
        std::map<std::string, std::string> first_of;
        std::string owner;
        for (std::size_t i = 0; i < file.lines.size(); ++i) {
            std::smatch match;
            if (std::regex_match(file.lines[i], match, begin)) {
                owner = match[1];
                first_of.clear();
            } else if (std::regex_match(file.lines[i], match, member)) {
                const auto [first, is_first] = first_of.try_emplace(match[1], match[2]);
                if (!is_first)
                    violations.push_back(path + ":" + std::to_string(i + 1) + ": " + owner +
                                         "::" + std::string(match[2]) + " takes what " + first->second +
                                         " is given: both are bare " + std::string(match[1]) +
                                         ", expected RELIDAR_OF");
            }
        }
    }
    return violations;
}

Violations check_primitive_questions(const SourceTree& tree) {
    static const std::regex question(
        R"(.*((case|[=!]=) *PrimitiveType::|PrimitiveType::\w+ *[=!]=|log_scale_w\.empty\(\)).*)");
    Violations violations;
    for (const auto& [path, file] : tree) {
        const std::string top = folder(path, 0);
        if ((top != "src" && top != "include" && top != "tools") || !has_extension(path, {".cpp", ".hpp"}))
            continue;
        for (std::size_t i = 0; i < file.lines.size(); ++i)
            if (std::regex_match(file.lines[i], question))
                violations.push_back(
                    path + ":" + std::to_string(i + 1) +
                    ": asks which primitive it is, expected a column of get_primitive_properties()");
    }
    return violations;
}

}  // namespace relidar::structure
