// SPDX-License-Identifier: Apache-2.0
#include "rules.hpp"

#include <algorithm>
#include <regex>
#include <set>
#include <utility>

namespace relidar::structure {
namespace {

using Names = std::set<std::string>;

/// Modules ("rooms") of src/, include/relidar/ and shaders/. A module includes only its
/// files and the modules before it in the list.
const std::vector<std::string> kRooms = {"base", "gpu",      "log",   "scene", "diff",
                                         "run",  "simulate", "score", "train"};

/// Folders whose private headers may be included by all modules. All other headers that
/// modules share must be public.
const std::vector<std::string> kOpenFolders = {"src/base/", "src/gpu/", "src/diff/traversal/"};

/// Headers of external libraries, each with the folders that may include it. All folders
/// may include headers that are not in this list.
const std::vector<std::pair<std::string, std::vector<std::string>>> kLibraries = {
    {"volk", {"src/gpu/"}},
    {"vulkan/", {"src/gpu/"}},
    {"Imf", {"src/base/codecs/"}},
    {"png.h", {"src/base/codecs/"}},
    {"lz4frame.h", {"src/base/codecs/"}},
    {"flatbuffers/", {"src/base/codecs/"}},
    {"sqlite3.h", {"src/log/readers/bag/"}},
    {"bzlib.h", {"src/log/readers/bag/"}},
    {"pcap/", {"src/log/readers/bag/"}},
    {"simdjson.h", {"src/log/readers/"}},
    {"protozero/", {"src/log/readers/", "src/simulate/scan_files/"}},
    {"pugixml.hpp", {"src/log/", "src/run/"}},
    {"toml++/", {"src/log/", "src/run/"}},
    {"nlohmann/", {"src/base/", "src/log/", "src/run/", "src/simulate/"}},
    {"nanoflann.hpp", {"src/base/", "src/scene/", "src/score/"}},
    {"tbb/", {"src/base/"}},
    {"oneapi/tbb", {"src/base/"}},
    {"Eigen/", {"src/base/", "src/log/", "src/scene/", "src/score/"}},
};

const std::string kPublic = "include/relidar/", kUmbrella = kPublic + "relidar.hpp",
                  kReaders = "src/log/readers/";

/// Public headers for users who write a custom trainer. <relidar/relidar.hpp> does not
/// include them.
const Names kTrainerHeaders = {"gpu/stream.hpp", "log/sensor_pattern.hpp", "scene/device_scene.hpp",
                               "run/stage_options.hpp", "run/checkpoint.hpp"};
/// Headers of diff/ that contain options. They are a part of <relidar/relidar.hpp>.
const Names kOptionHeaders = {"diff/densify_options.hpp", "diff/loss_options.hpp", "diff/loss_terms.h",
                              "diff/network.hpp"};

bool is_library(const std::string& path) {
    return path.starts_with("src/") || path.starts_with("shaders/") || path.starts_with(kPublic);
}

/// Returns the index of a file's module in kRooms, or the number of modules if the file
/// belongs to no module.
std::size_t find_room(const std::string& path) {
    const std::string name = folder(path, path.starts_with(kPublic) ? 2 : 1);
    return std::size_t(std::ranges::find(kRooms, name) - kRooms.begin());
}

/// Returns the dataset reader to which a file below src/log/readers/ belongs. Returns an
/// empty string for the registry, which includes all readers.
std::string find_reader(const std::string& path) {
    return path.starts_with(kReaders) && path.find('/', kReaders.size()) != std::string::npos
               ? folder(path, 3)
               : "";
}

bool has_any_prefix(const std::string& text, const std::vector<std::string>& prefixes) {
    return std::ranges::any_of(prefixes, [&](const std::string& prefix) { return text.starts_with(prefix); });
}

/// Returns an error message if a file of the library must not include a second file of
/// the library. Returns an empty string if the include is allowed.
std::string judge_library(const std::string& from, const std::string& to) {
    const std::size_t from_room = find_room(from), to_room = find_room(to);
    if (from == kUmbrella) return "";
    if (from_room == kRooms.size()) return from + " is in none of the nine rooms";
    if (to_room > from_room)
        return kRooms[from_room] + " may not include " +
               (to_room < kRooms.size() ? kRooms[to_room] : folder(to, 1));
    const bool is_shared = to.find("/shared/") != std::string::npos;
    if (from.starts_with(kPublic) && !to.starts_with(kPublic))
        return "a public header includes only public headers";
    if (from.starts_with("shaders/") && !to.starts_with("shaders/") && !to.ends_with(".h"))
        return "shaders include no C++";
    if (!find_reader(from).empty() && !find_reader(to).empty() && find_reader(from) != find_reader(to))
        return "readers do not include each other";
    if (from_room != to_room && to.starts_with("src/") && !has_any_prefix(to, kOpenFolders))
        return "another room is reached only through its public headers, <relidar/" + kRooms[to_room] +
               "/...>";
    if (from.starts_with("src/") && to.starts_with("shaders/") && !is_shared)
        return "C++ includes only shaders/*/shared";
    return "";
}

/// Returns the reason why an include is not allowed, or an empty string if it is allowed.
std::string judge(const std::string& from, const std::string& to) {
    const bool is_public = to.starts_with(kPublic);
    if (is_library(from))
        return is_library(to) ? judge_library(from, to) : "the library includes nothing of " + folder(to, 0);
    const std::string top = folder(from, 0), part = folder(from, 1),
                      to_part = folder(to, 0) + "/" + folder(to, 1);
    // the scene that all benchmarks share
    const bool is_benchmark_street = to == "src/scene/benchmark_street.hpp";
    if (top == "tools") {
        const bool is_command =
            part == "relidar" && (to_part == "tools/view" || to_part == "tools/serve" || is_benchmark_street);
        const bool is_measurement =
            (part == "relidar_dev" && (to_part == "tools/relidar" || to_part == "tools/serve")) ||
            ((part == "relidar_dev" || part == "bench") && folder(to, 0) == "src");
        // `relidar check` may include the reference of the tests, because it compares
        // private kernels with the reference.
        const bool is_check =
            from.starts_with("tools/relidar/check/") &&
            (folder(to, 0) == "src" || to_part == "tests/reference" || to_part == "tests/support");
        const bool is_sibling = to_part == "tools/" + part || to_part == "tools/network";
        return is_public || is_sibling || is_command || is_measurement || is_check
                   ? ""
                   : "tools see only include/relidar";
    }
    if (top == "tests" && part == "reference") {
        const bool is_test = stem(from).ends_with("_test");
        if (to_part == "tests/reference" || (is_test && (to_part == "tests/support" || is_benchmark_street)))
            return "";
        // header that only contains the names of values
        const bool is_table = to == "include/relidar/diff/blended_values.h";
        return is_public && (is_table || !to.ends_with(".h"))
                   ? ""
                   : "the reference includes nothing of src/, shaders/ or other tests";
    }
    return "";
}

/// Searches for the longest include path from a file by depth-first search.
class Chains {
public:
    explicit Chains(const SourceTree& tree) : tree_(tree) {}

    /// Returns the files on the longest include path that starts at a file. The first
    /// entry is the file itself. Cycles are stored as errors.
    const std::vector<std::string>& find_longest_chain_from(const std::string& path) {
        if (const auto cached_chain = longest_.find(path); cached_chain != longest_.end())
            return cached_chain->second;
        open_.push_back(path);
        std::vector<std::string> best;
        for (const Include& include : list_includes(tree_, tree_.at(path))) {
            if (std::ranges::find(open_, include.target) != open_.end()) {
                cycles_.push_back(path + ":" + std::to_string(include.line) + ": cycle of includes back to " +
                                  include.target);
                continue;
            }
            const std::vector<std::string>& included_chain = find_longest_chain_from(include.target);
            if (included_chain.size() > best.size()) best = included_chain;
        }
        open_.pop_back();
        best.insert(best.begin(), path);
        return longest_[path] = best;
    }

    const Violations& cycles() const { return cycles_; }

private:
    const SourceTree& tree_;
    std::vector<std::string> open_;
    std::map<std::string, std::vector<std::string>> longest_;
    Violations cycles_;
};

}  // namespace

Violations check_library_headers(const SourceTree& tree) {
    static const std::regex pattern(R"(^\s*#\s*include\s*<([^>]+)>)");
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (!is_code(path) || !(path.starts_with("src/") || path.starts_with(kPublic))) continue;
        for (std::size_t i = 0; i < file.lines.size(); ++i) {
            std::smatch match;
            if (!std::regex_search(file.lines[i], match, pattern)) continue;
            const std::string header = match[1];
            for (const auto& [library, folders] : kLibraries)
                if (header.starts_with(library) && !has_any_prefix(path, folders))
                    violations.push_back(path + ":" + std::to_string(i + 1) + ": <" + header +
                                         "> is not allowed here");
        }
    }
    return violations;
}

Violations check_include_edges(const SourceTree& tree) {
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (!is_code(path)) continue;
        for (const Include& include : list_includes(tree, file)) {
            const std::string wrong = judge(path, include.target);
            if (!wrong.empty())
                violations.push_back(path + ":" + std::to_string(include.line) + ": includes " +
                                     include.target + ": " + wrong);
        }
    }
    return violations;
}

Violations check_umbrella(const SourceTree& tree) {
    const auto is_deep = [](const std::string& name) {
        return kTrainerHeaders.contains(name) ||
               (name.starts_with("diff/") && !kOptionHeaders.contains(name)) ||
               (name.ends_with(".h") && !name.starts_with("scene/primitives") &&
                !kOptionHeaders.contains(name));
    };
    Violations violations;
    Names visited{kUmbrella};
    std::vector<std::string> open{kUmbrella};
    while (!open.empty()) {
        const std::string path = std::exchange(open.back(), {});
        open.pop_back();
        const auto file = tree.find(path);
        if (file == tree.end()) continue;
        for (const Include& include : list_includes(tree, file->second)) {
            const std::string& to = include.target;
            if (to.starts_with(kPublic) && is_deep(to.substr(kPublic.size())))
                violations.push_back(path + ":" + std::to_string(include.line) + ": includes " + to +
                                     ", which <relidar/relidar.hpp> must not include");
            else if (visited.insert(to).second) open.push_back(to);
        }
    }
    return violations;
}

Violations check_include_chains(const SourceTree& tree) {
    // Tests may have longer include paths, because they also include the reference and
    // the scene generator.
    constexpr std::size_t kLongest = 8, kLongestOfTests = 10;
    Violations violations;
    Chains chains(tree);
    for (const auto& [path, file] : tree) {
        if (!is_code(path)) continue;
        const std::vector<std::string>& chain = chains.find_longest_chain_from(path);
        if (chain.size() <= (path.starts_with("tests/") ? kLongestOfTests : kLongest)) continue;
        std::string text = path + ":1: chain of " + std::to_string(chain.size()) + " includes:";
        for (const std::string& link : chain) text += " " + link;
        violations.push_back(text);
    }
    violations.insert(violations.end(), chains.cycles().begin(), chains.cycles().end());
    return violations;
}

}  // namespace relidar::structure
