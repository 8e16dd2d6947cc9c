// SPDX-License-Identifier: Apache-2.0
// Reads and writes asset.json. The file describes an asset and is stored next to the
// files of the asset's run.
#include <relidar/simulate/assets.hpp>

#include <algorithm>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/files.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr const char* kAssetFormat = "relidar asset";
constexpr int kAssetVersion = 1;
constexpr double kAssetMost = 1e9;  // largest valid count or length
constexpr ObjectKind kAssetKinds[] = {ObjectKind::vehicle, ObjectKind::cyclist, ObjectKind::person,
                                      ObjectKind::other};

std::string format_asset_description_as_json(const AssetDescription& facts) {
    nlohmann::ordered_json sides;
    for (std::size_t s = 0; s < kBoxSides; ++s) sides[get_name(BoxSide(s))] = facts.seen_sides[s];
    const nlohmann::ordered_json json = {
        {"format", kAssetFormat},
        {"version", kAssetVersion},
        {"name", facts.name},
        {"class", facts.category},
        {"kind", get_name(facts.kind)},
        {"size_m", {facts.size_m.x, facts.size_m.y, facts.size_m.z}},
        {"source", {{"run", facts.source_run}, {"track", facts.source_track}, {"sensor", facts.sensor}}},
        {"score", facts.get_observed_or_mirrored_surface_fraction()},
        {"seen", facts.seen},
        {"seen_sides", sides},
        {"completed", facts.completed},
        {"clearance_m", facts.clearance_m},
        {"nearest_m", facts.nearest_m},
        {"surfels", facts.surfels},
        {"mirrored_surfels", facts.mirrored}};
    return json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

ObjectKind read_object_kind(const JsonField& field) {
    const std::string word = field.get_string();
    const auto kind = std::ranges::find_if(kAssetKinds, [&](ObjectKind k) { return word == get_name(k); });
    if (kind == std::end(kAssetKinds))
        field.throw_field_error("found \"" + word + "\"", "expected vehicle, cyclist, person or other");
    return *kind;
}

}  // namespace

void save_asset(ActorAsset asset, const fs::path& folder) {
    asset.run.folder = folder;
    save_run(asset.run);
    write_text_file(folder / kAssetFile, format_asset_description_as_json(asset.facts));
}

AssetDescription read_asset_description(const fs::path& folder) {
    const std::string file = (folder / kAssetFile).string();
    const nlohmann::json json = parse_json(read_text_file(file), file);
    const JsonField root(json, file, "");
    if (const std::string format = root.at("format").get_string(); format != kAssetFormat)
        root.at("format").throw_field_error("found \"" + format + "\"",
                                            fmt::format("expected \"{}\"", kAssetFormat));
    root.at("version").get_integer_in_range(kAssetVersion, kAssetVersion);
    AssetDescription facts;
    facts.name = root.at("name").get_short_single_line_string(200);
    facts.category = root.at("class").get_short_single_line_string(200);
    facts.kind = read_object_kind(root.at("kind"));
    const std::array<double, 3> size_m = root.at("size_m").get_numbers<3>();
    facts.size_m = {size_m[0], size_m[1], size_m[2]};
    facts.source_run = root.at("source").at("run").get_string();
    facts.source_track = root.at("source").at("track").get_string();
    facts.sensor = root.at("source").at("sensor").get_short_single_line_string(200);
    for (std::size_t s = 0; s < kBoxSides; ++s)
        facts.seen_sides[s] = root.at("seen_sides").at(get_name(BoxSide(s))).get_number_in_range(0.0, 1.0);
    facts.seen = root.at("seen").get_number_in_range(0.0, 1.0);
    facts.completed = root.at("completed").get_number_in_range(0.0, 1.0);
    facts.clearance_m = root.at("clearance_m").get_number_in_range(-kAssetMost, kAssetMost);
    facts.nearest_m = root.at("nearest_m").get_number_in_range(0.0, kAssetMost);
    facts.surfels = std::size_t(root.at("surfels").get_integer_in_range(0, std::int64_t(kAssetMost)));
    facts.mirrored =
        std::size_t(root.at("mirrored_surfels").get_integer_in_range(0, std::int64_t(kAssetMost)));
    return facts;
}

std::optional<double> read_asset_ground_clearance(const TrainedRun& run) {
    if (run.folder.empty() || !does_path_exist(run.folder / kAssetFile)) return {};
    return read_asset_description(run.folder).clearance_m;
}

std::vector<fs::path> list_asset_folders(const fs::path& folder) {
    require_existing_folder(folder, "a folder of `relidar assets`");
    std::vector<fs::path> assets = list_folder_entries(folder);
    std::erase_if(assets, [](const fs::path& entry) { return !does_path_exist(entry / kAssetFile); });
    if (assets.empty())
        fail("{} contains no asset, expected folders with an {}", folder.string(), kAssetFile);
    return assets;
}

}  // namespace relidar
