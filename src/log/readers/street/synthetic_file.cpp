// SPDX-License-Identifier: Apache-2.0
// Reads and writes street.toml. This file has one key for each option of a synthetic log.
// If a key is missing, the option has its default value. An unknown key is an error.
#include "base/fail.hpp"
#include "log/readers/street/synthetic.hpp"

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
#include "log/clouds/log_files.hpp"
#include "log/readers/readers.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

const std::vector<std::string> kKeys{"seed",      "n_frames",    "rows",   "columns", "range_noise_m",
                                     "speed_mps", "moving_cars", "people", "gait",    "rig"};

/// Accepts an integer as a real number.
/// @throws DataError for another type
template <class T>
void read_toml_value_if_present(const toml::table& table, const char* key, const char* expected_type_text,
                                const std::string& file_name, T& value) {
    const toml::node* node = table.get(key);
    if (!node) return;
    // toml++ converts real numbers to integers without an error.
    const bool is_cut = std::is_integral_v<T> && node->is_floating_point();
    const auto parsed_value = is_cut ? std::nullopt : node->value<T>();
    if (!parsed_value)
        fail("{} line {}: {} has the wrong type or size, expected {}", file_name, node->source().begin.line,
             key, expected_type_text);
    value = *parsed_value;
}

/// Keeps the scans. Used to test the effect of wrong poses.
void replace_poses_from_file(LidarSequence& sequence, const fs::path& user_pose_file) {
    std::vector<int> frames;
    // All LiDARs of a frame share one pose.
    for (const LidarFrame& frame : sequence.frames)
        if (frames.empty() || frames.back() != frame.index) frames.push_back(frame.index);
    PoseTrack track{sequence.world_from_vehicle.time_s, std::vector<Pose>(frames.size())};
    if (user_pose_file != kNoPoses) {
        track.pose = kitti::read_user_pose_file(user_pose_file, frames, track.time_s, sequence.notes);
        track = add_offset_to_track_positions(std::move(track), -sequence.world_offset_m);
    }
    set_vehicle_poses(sequence, std::move(track));
    sequence.conventions += user_pose_file == kNoPoses
                                ? " No poses are read, so the sensor is at the origin in every frame."
                                : " Poses are read from " + user_pose_file.string();
}

SyntheticOptions read_street_toml(const fs::path& toml_file) {
    const std::string file = toml_file.string();
    const std::string text = read_text_file(toml_file);
    require_toml_nesting_within_limit(text, file);
    toml::table table;
    try {
        table = toml::parse(text, file);
    } catch (const toml::parse_error& error) {
        fail("{} line {}: malformed TOML: {}", file, error.source().begin.line,
             shorten_for_error_message(error.description()));
    }
    for (const auto& [key, value] : table) {
        const std::string name(key.str());
        if (std::find(kKeys.begin(), kKeys.end(), name) != kKeys.end()) continue;
        fail("{} line {}: unknown key '{}'{} (known: {})", file, value.source().begin.line,
             shorten_for_error_message(name), format_name_suggestion(name, kKeys, "'"),
             fmt::join(kKeys, ", "));
    }
    SyntheticOptions options;
    std::int64_t seed = std::int64_t(options.seed);
    read_toml_value_if_present(table, "seed", "a whole number", file, seed);
    options.seed = std::uint64_t(seed);
    read_toml_value_if_present(table, "n_frames", "a whole number", file, options.n_frames);
    read_toml_value_if_present(table, "rows", "a whole number", file, options.rows);
    read_toml_value_if_present(table, "columns", "a whole number", file, options.columns);
    read_toml_value_if_present(table, "range_noise_m", "a number", file, options.range_noise_m);
    read_toml_value_if_present(table, "speed_mps", "a number", file, options.speed_mps);
    read_toml_value_if_present(table, "moving_cars", "true or false", file, options.moving_cars);
    read_toml_value_if_present(table, "people", "true or false", file, options.people);
    read_toml_value_if_present(table, "gait", "true or false", file, options.gait);
    read_toml_value_if_present(table, "rig", "a file", file, options.rig);
    // relative to the folder of street.toml
    if (!options.rig.empty()) options.rig = (toml_file.parent_path() / options.rig).string();
    return options;
}

}  // namespace

LidarSequence load_synthetic_dataset(const fs::path& folder, const DatasetOptions& options) {
    const fs::path file = folder / "street.toml";
    const SyntheticOptions street = read_synthetic_options(folder);
    const int end = options.frames.end < 0 ? street.n_frames : std::min(options.frames.end, street.n_frames);
    if (street.n_frames > 0 && options.frames.begin >= end)
        fail<UsageError>("frames {}:{} select no frame of {}, expected numbers in [0, {}]",
                         options.frames.begin,
                         options.frames.end < 0 ? "" : std::to_string(options.frames.end), folder.string(),
                         street.n_frames - 1);
    LidarSequence sequence;
    try {
        sequence = make_synthetic_frames(street, options.frames.begin, end);
        // The wrong value is in a file, not on the command line.
    } catch (const UsageError& error) {
        fail("{}: {}", file.string(), error.what());
    }
    sequence.source = folder.string();
    if (!options.poses_file.empty()) replace_poses_from_file(sequence, options.poses_file);
    return sequence;
}

SyntheticOptions read_synthetic_options(const fs::path& folder) {
    return read_street_toml(folder / "street.toml");
}

void save_synthetic_options(const SyntheticOptions& options, const fs::path& folder) {
    std::error_code failed;
    fs::create_directories(folder, failed);
    const fs::path file = folder / "street.toml";
    std::ofstream out(file);
    out << fmt::format(
        "seed = {}\nn_frames = {}\nrows = {}\ncolumns = {}\nrange_noise_m = {}\nspeed_mps = {}\nmoving_cars "
        "= {}\npeople = {}\ngait = {}\n",
        std::int64_t(options.seed), options.n_frames, options.rows, options.columns,
        format_number_text(options.range_noise_m), format_number_text(options.speed_mps), options.moving_cars,
        options.people, options.gait);
    if (!options.rig.empty()) out << "rig = " << toml::value(fs::absolute(options.rig).string()) << "\n";
    if (!out.flush()) fail("cannot write {}", file.string());
}

}  // namespace relidar
