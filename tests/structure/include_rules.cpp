// SPDX-License-Identifier: Apache-2.0
#include "rules.hpp"

#include <algorithm>
#include <set>
#include <utility>

namespace relidar::structure {
namespace {

using Stages = std::set<std::string>;

/// Which other stages a stage may include; core is open to all and not listed.
const std::map<std::string, Stages>& layer_table() {
    static const std::map<std::string, Stages> table = {
        {"core", {}},
        {"channels", {}},
        {"gpu", {}},
        {"sensor", {}},
        {"sequence", {"sensor"}},
        {"scatter", {}},
        {"weather", {}},
        {"coverage", {"sequence", "sensor"}},
        {"reader", {"sequence", "sensor"}},                                       // what all readers of datasets share
        {"dataset", {"reader", "sensor_files", "export", "sequence", "sensor"}},  // export: npz
        {"registration", {"sequence", "sensor"}},
        {"scene", {"sequence", "sensor", "gpu"}},
        {"edit", {"run", "scene", "sequence", "sensor"}},
        {"accel", {"scene", "gpu"}},
        {"optimizer", {"scene", "gpu"}},
        {"loss", {"traversal", "scene", "gpu"}},
        {"metrics", {"sequence", "sensor", "gpu"}},
        {"refine", {"optimizer", "gpu"}},
        {"export", {"channels", "metrics", "scene", "sequence", "sensor"}},  // metrics: the rows a report shows
        {"forward", {"traversal", "accel", "scene", "sequence", "sensor", "gpu"}},
        {"densify", {"optimizer", "scene", "gpu"}},
        {"checkpoint", {"export", "scene", "optimizer", "refine", "gpu"}},  // export: safetensors
        {"traversal", {"accel", "scene", "gpu"}},                           // rays and hits: what forward and backward share
        {"backward", {"traversal", "forward", "accel", "scene", "gpu"}},
        {"differentiable_renderer", {"backward", "forward", "traversal", "accel", "scene", "gpu"}},
        // options of all of them
        {"config",
         {"channels", "traversal", "accel", "forward", "backward", "loss", "optimizer", "densify", "refine", "scene", "sequence", "sensor",
          "gpu"}},
        {"run", {"config", "coverage", "export", "refine", "scatter", "scene", "sequence", "sensor"}},  // export: safetensors
        {"sensor_files", {"sensor", "export"}},                                  // export: npz
        {"render",
         {"channels", "sensor_files", "config", "coverage", "run", "forward", "traversal", "refine", "accel", "metrics", "scatter",
          "weather", "scene", "sequence", "sensor", "gpu"}},
        {"assets", {"render", "run", "edit", "export", "config", "scene", "sequence", "sensor", "gpu"}},   // export: write_text
        {"scan_files", {"channels", "render", "run", "export", "config", "metrics", "scene", "sequence", "sensor", "weather"}},
        {"evaluation", {"render", "run", "config", "export", "metrics", "scene", "sequence", "sensor", "gpu"}},  // export: weights of LPIPS
        {"blocks", {"run", "config", "coverage", "scene", "sequence", "sensor"}},
        {"train", {"channels",   "config",   "run",       "render",    "differentiable_renderer",
                   "backward",   "forward",  "traversal", "densify",
                   "checkpoint", "accel",    "optimizer", "loss",
                   "metrics",    "refine",   "dataset",   "registration",
                   "scene",      "sequence", "sensor",    "gpu",       "coverage",
                   "scatter"}},
    };
    return table;
}

const std::string kFaces = "include/relidar/", kUmbrella = kFaces + "relidar.hpp";
const Stages kCoreFaces = {"error", "math", "progress", "process_group", "version"};
const Stages kOpenFolders = {"core", "gpu", "traversal", "shared"};   // infrastructure: its headers are included directly

/// Layer of a file: a stage; "shared"; "shaders/<folder>"; "tools/<name>"; "tests/<folder>"; or empty for others.
std::string layer_of(const std::string& path) {
    const std::string top = folder(path, 0), second = folder(path, 1);
    if (path.starts_with(kFaces + "shared/")) return "shared";
    if (path.starts_with(kFaces)) return kCoreFaces.contains(stem(path)) ? "core" : stem(path);
    if (top == "src") return second;
    if (top == "shaders") return second == "shared" ? "shared" : "shaders/" + second;
    if (top == "tools" || top == "tests") return top + "/" + second;
    return "";
}

/// May a shader of layer `from` include one of layer `to`? Kernels see the common folders and their own, never another stage's.
bool shader_may_include(const std::string& from, const std::string& to) {
    static const std::vector<std::string> order = {"shared", "shaders/common", "shaders/gaussian", "shaders/traversal"};
    const auto from_at = std::ranges::find(order, from), to_at = std::ranges::find(order, to);
    return to_at != order.end() && to_at <= from_at;
}

bool stage_may_include(const std::string& from, const std::string& to) {
    const Stages& allowed = layer_table().at(from);
    if (to == "shared") return from == "gpu" || allowed.contains("gpu");
    return to == "core" || allowed.contains(to);
}

/// What is wrong with an include, or nothing.
std::string judge(const std::string& from_path, const std::string& to_path) {
    const std::string from = layer_of(from_path), to = layer_of(to_path);
    const bool to_face = to_path.starts_with(kFaces);
    if (from == to) return "";
    if (from_path == kUmbrella)
        return to_path.starts_with(kFaces + "stages/") ? "the umbrella holds what users need" : "";
    if (from_path.starts_with("shaders/")) return shader_may_include(from, to) ? "" : from + " may not include " + to;
    if (from == "tools/relidar" && (to == "tools/view" || to == "tools/serve")) return "";   // commands on top of their servers
    if (from == "tools/relidar_dev" && (to == "tools/relidar" || to == "tools/serve")) return "";
    // programs that measure relidar include private headers, and one scene is shared with relidar bench
    if ((from == "tools/relidar_dev" || from == "tools/bench") && to_path.starts_with("src/")) return "";
    if (from == "tools/relidar" && to_path == "src/scene/benchmark_street.hpp") return "";
    if (from.starts_with("tools/") && to == "tools/network") return "";   // what servers share
    if (from.starts_with("tools/")) return to_face ? "" : "tools see only include/relidar";
    const bool is_test = stem(from_path).ends_with("_test");
    if (from == "tests/reference" && is_test && (to == "tests/support" || to_path == "src/scene/benchmark_street.hpp")) return "";
    if (from == "tests/reference")
        return to_face && to != "shared" ? "" : "the reference includes nothing of src/, shaders/ or other tests";
    if (from.empty() || from.starts_with("tests/")) return "";
    if (!layer_table().contains(from)) return "'" + from + "' is no stage of the layer table";
    if (from_path.starts_with(kFaces) && !to_face) return "a face includes only other faces";
    if (!stage_may_include(from, to)) return from + " may not include " + to;
    if (!to_face && !kOpenFolders.contains(to))
        return "another stage is reached only through its faces, <relidar/" + to + ".hpp> or <relidar/stages/" + to + ".hpp>";
    return "";
}

/// Longest include path from a file, found depth first.
class Chains {
public:
    explicit Chains(const SourceTree& tree) : tree_(tree) {}

    /// Files on the longest path that starts here, this one first. Records cycles.
    const std::vector<std::string>& longest_from(const std::string& path) {
        if (const auto known = longest_.find(path); known != longest_.end()) return known->second;
        open_.push_back(path);
        std::vector<std::string> best;
        for (const Include& include : includes_of(tree_, tree_.at(path))) {
            if (std::ranges::find(open_, include.target) != open_.end()) {
                cycles_.push_back(path + ":" + std::to_string(include.line) + ": cycle of includes back to " + include.target);
                continue;
            }
            const std::vector<std::string>& tail = longest_from(include.target);
            if (tail.size() > best.size()) best = tail;
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

bool is_code(const std::string& path) { return has_extension(path, {".cpp", ".hpp", ".h", ".comp", ".glsl"}); }

bool reaches(const std::string& from, const std::string& goal, Stages& seen) {
    for (const std::string& next : layer_table().at(from)) {
        if (next == goal) return true;
        if (seen.insert(next).second && reaches(next, goal, seen)) return true;
    }
    return false;
}

}  // namespace

bool is_stage(const std::string& name) { return layer_table().contains(name); }

Violations check_layer_table() {
    Violations violations;
    for (const auto& [name, allowed] : layer_table()) {
        Stages seen;
        if (reaches(name, name, seen)) violations.push_back("stage " + name + " may reach itself through the layer table");
    }
    return violations;
}

Violations check_include_edges(const SourceTree& tree) {
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (!is_code(path)) continue;
        for (const Include& include : includes_of(tree, file)) {
            const std::string wrong = judge(path, include.target);
            if (!wrong.empty())
                violations.push_back(path + ":" + std::to_string(include.line) + ": includes " + include.target + ": " + wrong);
        }
    }
    return violations;
}

Violations check_umbrella(const SourceTree& tree) {
    const Stages lists{kFaces + "shared/loss_terms.h", kFaces + "shared/primitives.h"};   // settings are made of these
    Violations violations;
    Stages seen{kUmbrella};
    std::vector<std::string> open{kUmbrella};
    while (!open.empty()) {
        const std::string path = std::exchange(open.back(), {});
        open.pop_back();
        const auto file = tree.find(path);
        if (file == tree.end()) continue;
        for (const Include& include : includes_of(tree, file->second)) {
            const std::string& to = include.target;
            const bool is_deep = to.starts_with(kFaces + "stages/") ||
                                 (to.starts_with(kFaces + "shared/") && !lists.contains(to));
            if (is_deep)
                violations.push_back(path + ":" + std::to_string(include.line) + ": includes " + to +
                                     ", which <relidar/relidar.hpp> must not bring");
            else if (seen.insert(to).second) open.push_back(to);
        }
    }
    return violations;
}

Violations check_include_chains(const SourceTree& tree) {
    constexpr std::size_t kLongest = 8, kLongestOfTests = 10;   // tests stand on top: the oracle, then a generator of scenes
    Violations violations;
    Chains chains(tree);
    for (const auto& [path, file] : tree) {
        if (!is_code(path)) continue;
        const std::vector<std::string>& chain = chains.longest_from(path);
        if (chain.size() <= (path.starts_with("tests/") ? kLongestOfTests : kLongest)) continue;
        std::string text = path + ":1: chain of " + std::to_string(chain.size()) + " includes:";
        for (const std::string& link : chain) text += " " + link;
        violations.push_back(text);
    }
    violations.insert(violations.end(), chains.cycles().begin(), chains.cycles().end());
    return violations;
}

}  // namespace relidar::structure
