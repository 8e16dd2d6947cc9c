// SPDX-License-Identifier: Apache-2.0
// Reads and writes street.toml. This file has one key for each option of a synthetic log.
// If a key is missing, the option has its default value. An unknown key is an error.
#include "base/fail.hpp"

#include <algorithm>
#include <fstream>
#include <optional>
#include <type_traits>

#include <fmt/format.h>
#include <toml++/toml.h>

#include <relidar/base/error.hpp>
#include "base/files.hpp"
#include "base/number_text.hpp"
#include "base/toml_depth.hpp"
#include "read/datasets/street/street.hpp"
#include "read/readers.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

/// Calls visit(key, option, type) for each option of street.toml.
template <class Options, class Visit>
void visit_street_options(Options& options, const Visit& visit) {
    visit("seed", options.seed, "a whole number");
    visit("n_frames", options.n_frames, "a whole number");
    visit("rows", options.rows, "a whole number");
    visit("columns", options.columns, "a whole number");
    visit("range_noise_m", options.range_noise_m, "a number");
    visit("speed_mps", options.speed_mps, "a number");
    visit("moving_cars", options.moving_cars, "true or false");
    visit("people", options.people, "true or false");
    visit("gait", options.gait, "true or false");
    visit("rig", options.rig, "a file");
}

/// Reads street.toml. A missing key keeps its default value. An unknown key or a value of
/// the wrong type is an error.
StreetOptions parse_street_toml(const fs::path& toml_file) {
    const std::string file = toml_file.string();
    const std::string text = read_text_file(toml_file);
    check_toml_depth(text, file);
    toml::table table;
    try {
        table = toml::parse(text, file);
    } catch (const toml::parse_error& error) {
        fail("{} line {}: malformed TOML: {}", file, error.source().begin.line, quote(error.description()));
    }
    StreetOptions options;
    std::vector<std::string> keys;
    visit_street_options(options, [&]<class T>(const char* key, T& option, const char* type) {
        keys.emplace_back(key);
        const toml::node* node = table.get(key);
        if (!node) return;
        // TOML has only signed integers.
        using Stored = std::conditional_t<std::is_same_v<T, std::uint64_t>, std::int64_t, T>;
        // toml++ would convert a real number to an integer without an error.
        const bool loses_digits = std::is_integral_v<T> && node->is_floating_point();
        const auto value = loses_digits ? std::nullopt : node->value<Stored>();
        if (!value)
            fail("{} line {}: {} has the wrong type or size, expected {}", file, node->source().begin.line,
                 key, type);
        option = T(*value);
    });
    for (const auto& [key, value] : table) {
        const std::string name(key.str());
        if (std::ranges::find(keys, name) == keys.end())
            fail("{} line {}: unknown key '{}'{} (known: {})", file, value.source().begin.line, quote(name),
                 did_you_mean(name, keys, "'"), fmt::join(keys, ", "));
    }
    // relative to the folder of street.toml
    if (!options.rig.empty()) options.rig = (toml_file.parent_path() / options.rig).string();
    return options;
}

}  // namespace

Log load_synthetic(const fs::path& folder, const DatasetOptions& options) {
    const fs::path file = folder / "street.toml";
    const StreetOptions street = load_street(folder);
    FrameRange frames;  // make_frames() rejects a street without frames
    if (street.n_frames > 0) frames = limit_frames(options.frames, street.n_frames, folder.string());
    Log log;
    try {
        log = make_frames(street, frames.begin, frames.end);
        // The wrong value is in a file and not on the command line, so it is a DataError.
    } catch (const UsageError& error) {
        fail("{}: {}", file.string(), error.what());
    }
    log.source = folder.string();
    // Wrong poses with the same scans show the effect of the poses.
    read::replace_poses(log, options);
    if (!options.poses_file.empty())
        log.conventions += " Poses are replaced by dataset.poses=" + options.poses_file.string();
    return log;
}

StreetOptions load_street(const fs::path& folder) { return parse_street_toml(folder / "street.toml"); }

void save_street(const StreetOptions& options, const fs::path& folder) {
    std::error_code failed;
    fs::create_directories(folder, failed);
    const fs::path file = folder / "street.toml";
    std::ofstream out(file);
    // Writes "key = value". The last argument, the name of a type, is only for readers.
    visit_street_options(options, [&]<class T>(const char* key, const T& option, const char*) {
        if constexpr (std::is_same_v<T, std::string>) {  // a path; empty, its default, is not written
            // An absolute path does not depend on the working folder.
            if (!option.empty()) out << key << " = " << toml::value(fs::absolute(option).string()) << "\n";
        } else if constexpr (std::is_same_v<T, double>)
            out << fmt::format("{} = {}\n", key, number_text(option));
        else if constexpr (std::is_same_v<T, std::uint64_t>)  // TOML has only signed integers
            out << fmt::format("{} = {}\n", key, std::int64_t(option));
        else out << fmt::format("{} = {}\n", key, option);
    });
    if (!out.flush()) fail("cannot write {}", file.string());
}

}  // namespace relidar
