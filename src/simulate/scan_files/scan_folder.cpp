// SPDX-License-Identifier: Apache-2.0
// Writes the output folder of a rendering. Removes the files of an earlier rendering, and
// writes the list of scans to scans.json.

#include <cstring>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/base/files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/actor_boxes.hpp>
#include "base/fail.hpp"
#include "log/sensor_files/camera_json.hpp"
#include "simulate/scan_files/placed_scan.hpp"
#include "simulate/scan_files/recording_format.hpp"
#include "simulate/scan_files/scan_folder.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char *kSummaryName = "scans.json", *kSummaryFormat = "relidar scans";
// exists while a rendering is not finished
constexpr const char* kUnfinishedName = ".unfinished_scans";

/// Returns true if a rendering writes files with such a name: scans.json, a recording, a
/// capture, or frame_<number>.<format>.
bool is_output_name(const fs::path& name) {
    const auto is_named = [&](const scan_files::RecordingFormat& format) { return name == format.file; };
    if (name == kSummaryName || scan_files::PacketFileWriter::is_packet_file(name) ||
        std::ranges::any_of(scan_files::recording_formats(), is_named))
        return true;
    std::string stem = name.stem().string();
    if (stem.ends_with(scan_files::kDepthEnding))
        stem.resize(stem.size() - std::strlen(scan_files::kDepthEnding));
    const std::string prefix = "frame_", extension = name.extension().string();
    const bool has_number = stem.starts_with(prefix) && stem.size() > prefix.size() &&
                            stem.find_first_not_of("0123456789", prefix.size()) == std::string::npos;
    if (!has_number || extension.empty()) return false;
    const std::vector<std::string> formats = scan_formats();
    return std::ranges::find(formats, extension.substr(1)) != formats.end();
}

std::vector<fs::path> output_files(const fs::path& folder) {
    std::vector<fs::path> files;
    std::error_code failed;
    for (const auto& entry : fs::directory_iterator(folder, failed))
        if (is_output_name(entry.path().filename())) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    return files;
}

/// Returns the names of all files that the scans.json of a folder lists, and scans.json.
/// Returns no names for a file of another program.
std::set<std::string> listed_names(const fs::path& folder) {
    std::ifstream file(folder / kSummaryName);
    const Json json = Json::parse(file, nullptr, false);
    std::set<std::string> names;
    if (!json.is_object() || json.value("format", Json()) != kSummaryFormat) return names;
    names.insert(kSummaryName);
    const auto add = [&](const Json& list) {
        for (const Json& name : list)
            if (name.is_string()) names.insert(name.get<std::string>());
    };
    add(json.value("recordings", Json::array()));
    for (const Json& scan : json.value("scans", Json::array()))
        if (scan.is_object()) add(scan.value("files", Json::array()));
    return names;
}

Json matrix_json(const Pose& pose) {
    const std::vector<double> m = scan_files::row_major(pose);
    Json rows = Json::array();
    for (std::size_t i = 0; i < m.size(); i += 4) rows.push_back({m[i], m[i + 1], m[i + 2], m[i + 3]});
    return rows;
}

/// Returns a JSON object with the value of each setting. Numbers and booleans keep their
/// type. Other values become strings, and paths become names.
Json settings_json(const Config& config) {
    Json json = Json::object();
    for (const ConfigKey& key : list_config_keys(config)) {
        const Json value = Json::parse(key.value, nullptr, false);
        const bool is_path = key.key == "dataset.path" || key.value.starts_with('/');
        json[key.key] = value.is_number() || value.is_boolean()
                            ? value
                            : Json(is_path ? file_name_of(key.value) : key.value);
    }
    return json;
}

Json channels_json(const std::vector<ChannelInfo>& channels) {
    Json json = Json::object();
    const auto add = [&](const ChannelInfo& channel) {
        json[channel.name] = {{"unit", channel.unit}, {"meaning", channel.meaning}};
    };
    std::ranges::for_each(file_channels(), add);
    std::ranges::for_each(channels, add);
    return json;
}

}  // namespace

/// Checks the formats and creates a missing folder. Does not change existing files.
void ScanFolderWriter::open_folder(fs::path folder, ScanOutputOptions format) {
    folder_ = std::move(folder);
    format_ = std::move(format);
    const std::vector<std::string> known = scan_formats();
    for (const std::string& name : format_.formats)
        if (std::ranges::find(known, name) == known.end())
            fail<UsageError>("cannot write scans: the format \"{}\" is unknown{} (known formats: {})", name,
                             did_you_mean(name, known), fmt::join(known, ", "));
    prepare_folder(folder_);
    channels_ = parse_channels(format_.config.render.channels);
}

ScanFolderWriter ScanFolderWriter::join_folder(fs::path folder, ScanOutputOptions options) {
    ScanFolderWriter joined;
    joined.open_folder(std::move(folder), std::move(options));
    for (const std::string& name : joined.format_.formats)
        if (is_recording(name))
            fail<UsageError>("the format {} stores all scans in one file; expected a single process", name);
    return joined;
}

ScanFolderWriter::ScanFolderWriter(fs::path folder, ScanOutputOptions format) {
    open_folder(std::move(folder), std::move(format));
    recordings_ = std::make_shared<ScanRecordingsWriter>(folder_, std::vector{format_});
    // While the marker exists, the scans are unfinished. finish() removes it.
    const fs::path marker = folder_ / kUnfinishedName;
    // Holds no object. Its deleter runs when the last copy of this writer is destroyed.
    unfinished_marker_ = std::shared_ptr<void>(nullptr, [marker](void*) {
        std::error_code failed;
        if (output_files(marker.parent_path()).empty()) fs::remove(marker, failed);
    });
    write_text_file(marker, "relidar has not finished the scans in this folder\n");
}

void ScanFolderWriter::finish() {
    if (recordings_) recordings_->finish();
    write_summary();
    fs::remove(folder_ / kUnfinishedName);
}

void ScanFolderWriter::write_summary() const {
    const Config& config = format_.config;
    const bool world = format_.frame == PointCoordinateFrame::world;
    const std::string range = config.render.points == "median" ? "median" : config.render.range;
    const Json points = {
        {"frame", world ? "world" : "sensor"},
        {"deskewed", has_common_frame(format_)},
        {"range", range},
        {"returned", "drop_prob < 0.5"},
        {"returns", config.sensor.returns == 2 ? "1: the strongest return, 2: the last return, or the second "
                                                 "strongest if the last is the strongest"
                                               : "one return per ray"}};
    Json json = {
        {"format", kSummaryFormat},
        {"version", 1},
        {"relidar", RELIDAR_VERSION},
        {"run", format_.run},
        {"dataset", file_name_of(config.dataset.path)},
        {"sensor",
         {{"name", format_.sensor},
          {"min_range_m", format_.limits.min_m},
          {"max_range_m", format_.limits.max_m}}},
        {"sensor_offset", matrix_json(format_.offset)},
        {"trajectory", format_.trajectory.empty() ? Json() : Json(format_.trajectory)},
        {"time_shift_ns", format_.time_shift_ns},
        {"units", "metres, seconds; times of points are relative to time_s; intensity, drop_prob: 0 to 1"},
        {"points", points},
        {"channels", channels_json(channels_)},
        {"instances", format_.instance_names},
        {"only", format_.only},
        {"sample", format_.sample ? Json(*format_.sample) : Json()},
        {"weather", format_weather(format_.weather)},
        {"recordings", Json::array()},
        {"scans", Json::array()},
        {"settings", settings_json(config)}};
    if (format_.camera) json["camera"] = camera_json(*format_.camera);
    if (format_.map) json["points"]["crs"] = format_.map->crs();
    if (format_.vehicle) {
        json["vehicle"] = Json::parse(format_.vehicle->json);
        json["vehicle"]["base_link_from_sensor"] = matrix_json(format_.vehicle_from_lidar * format_.offset);
        json["vehicle"]["base_link_height_m"] =
            format_.base_link_height_m ? Json(*format_.base_link_height_m) : Json();
    }
    if (const glm::dvec3 origin_m = points_origin_m(format_);
        world && !format_.map && origin_m != glm::dvec3(0.0))
        json["world_offset_m"] = {origin_m.x, origin_m.y, origin_m.z};
    if (recordings_) json["recordings"] = recordings_->list_file_names();
    for (const std::string& entry : entries_) json["scans"].push_back(Json::parse(entry));
    write_text_file(folder_ / kSummaryName, json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

namespace {

/// Returns the list "boxes" of a scan in scans.json. Its world frame is the dataset's.
Json boxes_json(const std::vector<ActorBox>& boxes) {
    Json json = Json::array();
    for (const ActorBox& box : boxes)
        json.push_back({{"track", box.track},
                        {"class", name_of(box.object_class)},
                        {"label", box.label},
                        {"is_discovered", box.is_discovered},
                        {"is_static", box.is_static},
                        {"note", name_of(box.note)},
                        {"size_m", {box.size_m.x, box.size_m.y, box.size_m.z}},
                        {"time_s", box.time_s},
                        {"world_from_box", matrix_json(box.dataset_from_box)},
                        {"velocity_mps", {box.velocity_mps.x, box.velocity_mps.y, box.velocity_mps.z}},
                        {"points", box.n_points},
                        {"visible_share", box.visible_share}});
    return json;
}

}  // namespace

std::string scan_files::entry_json(int frame, const RenderedScan& scan, const ScanOutputOptions& format,
                                   const std::vector<std::string>& files) {
    const std::vector<float>& range_m = point_ranges(scan, format.config);
    std::size_t n_points = 0;  // first returns
    for (std::size_t i = 0; i < range_m.size(); ++i)
        if (is_ray_returned(scan.image.drop_prob[i], range_m[i])) ++n_points;
    // Sides of actors that the log has not observed, but rays of the scan reach. Those
    // filled with mirrored surfels are listed separately.
    Json unseen = Json::array(), completed = Json::array();
    for (const UnobservedActorSide& side : scan.unseen_sides) {
        Json& list = side.is_completed ? completed : unseen;
        list.push_back({{"track", side.track}, {"side", name_of(side.side)}, {"rays", side.n_rays}});
    }
    const Json entry = {{"frame_number", frame},
                        {"time_s", scan.time_s},
                        {"world_from_sensor", matrix_json(scan.world_from_sensor)},
                        {"rays", scan.image.range_m.size()},
                        {"points", n_points},
                        {"dropped", scan.image.range_m.size() - n_points},
                        {"unseen", scan.unseen_share ? Json(*scan.unseen_share) : Json()},
                        {"unseen_sides", unseen},
                        {"completed_sides", completed},
                        {"boxes", boxes_json(actor_boxes_of(scan, format))},
                        {"files", files}};
    // Replaces invalid UTF-8 in names.
    return entry.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::vector<fs::path> list_scan_files(const fs::path& folder) {
    std::vector<fs::path> files = output_files(folder);
    std::error_code failed;
    if (files.empty() || fs::exists(folder / kUnfinishedName, failed)) return files;
    const std::set<std::string> listed = listed_names(folder);
    std::erase_if(files, [&](const fs::path& file) { return !listed.contains(file.filename().string()); });
    return files;
}

fs::path find_foreign_file(const fs::path& folder) {
    const std::vector<fs::path> ours = list_scan_files(folder);
    for (const fs::path& file : output_files(folder))
        if (!std::ranges::binary_search(ours, file)) return file;
    return {};
}

void scan_files::write_recordings(const fs::path& folder, const std::vector<std::string>& names) {
    const Json json = {{"format", kSummaryFormat},
                       {"version", 1},
                       {"relidar", RELIDAR_VERSION},
                       {"recordings", names},
                       {"scans", Json::array()}};
    write_text_file(folder / kSummaryName, json.dump(1) + "\n");
}

void scan_files::remove_scans(const fs::path& folder) {
    if (const fs::path foreign = find_foreign_file(folder); !foreign.empty())
        fail<UsageError>("cannot write scans to {}: found {}, which is not listed in a scans.json",
                         folder.string(), foreign.filename().string());
    for (const fs::path& file : list_scan_files(folder)) {
        std::error_code failed;
        fs::remove(file, failed);
        if (failed) fail("cannot remove {} of an earlier rendering: {}", file.string(), failed.message());
    }
    remove_temp(folder);
}

}  // namespace relidar
