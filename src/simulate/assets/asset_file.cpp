// SPDX-License-Identifier: Apache-2.0
// Reads and writes asset.json. The file describes an asset and is stored next to the
// files of the asset's run.
#include <relidar/simulate/assets.hpp>

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

std::string to_json(const AssetDescription& facts) {
    nlohmann::ordered_json sides;
    for (std::size_t s = 0; s < kBoxSides; ++s) sides[name_of(BoxSide(s))] = facts.seen_sides[s];
    const nlohmann::ordered_json json = {
        {"format", kAssetFormat},
        {"version", kAssetVersion},
        {"name", facts.name},
        {"class", facts.category},
        {"kind", name_of(facts.kind)},
        {"size_m", {facts.size_m.x, facts.size_m.y, facts.size_m.z}},
        {"source", {{"run", facts.source_run}, {"track", facts.source_track}, {"sensor", facts.sensor}}},
        {"score", facts.covered_share()},
        {"seen", facts.seen},
        {"seen_sides", sides},
        {"completed", facts.completed},
        {"clearance_m", facts.clearance_m},
        {"nearest_m", facts.nearest_m},
        {"surfels", facts.surfels},
        {"mirrored_surfels", facts.mirrored}};
    return json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

ObjectKind read_kind(const JsonField& field) {
    const std::string word = field.text();
    const auto kind = std::ranges::find_if(kAssetKinds, [&](ObjectKind k) { return word == name_of(k); });
    if (kind == std::end(kAssetKinds))
        field.reject("found \"" + word + "\"", "expected vehicle, cyclist, person or other");
    return *kind;
}

}  // namespace

void save_asset(ActorAsset asset, const fs::path& folder) {
    asset.run.folder = folder;
    save_run(asset.run);
    write_text_file(folder / kAssetFile, to_json(asset.facts));
}

AssetDescription read_description(const fs::path& folder) {
    const std::string file = (folder / kAssetFile).string();
    const nlohmann::json json = parse_json(read_text_file(file), file);
    const JsonField root(json, file, "");
    if (const std::string format = root.at("format").text(); format != kAssetFormat)
        root.at("format").reject("found \"" + format + "\"", fmt::format("expected \"{}\"", kAssetFormat));
    root.at("version").integer_in(kAssetVersion, kAssetVersion);
    AssetDescription facts;
    facts.name = root.at("name").short_text(200);
    facts.category = root.at("class").short_text(200);
    facts.kind = read_kind(root.at("kind"));
    const std::array<double, 3> size_m = root.at("size_m").numbers<3>();
    facts.size_m = {size_m[0], size_m[1], size_m[2]};
    facts.source_run = root.at("source").at("run").text();
    facts.source_track = root.at("source").at("track").text();
    facts.sensor = root.at("source").at("sensor").short_text(200);
    for (std::size_t s = 0; s < kBoxSides; ++s)
        facts.seen_sides[s] = root.at("seen_sides").at(name_of(BoxSide(s))).number_in(0.0, 1.0);
    facts.seen = root.at("seen").number_in(0.0, 1.0);
    facts.completed = root.at("completed").number_in(0.0, 1.0);
    facts.clearance_m = root.at("clearance_m").number_in(-kAssetMost, kAssetMost);
    facts.nearest_m = root.at("nearest_m").number_in(0.0, kAssetMost);
    facts.surfels = std::size_t(root.at("surfels").integer_in(0, std::int64_t(kAssetMost)));
    facts.mirrored = std::size_t(root.at("mirrored_surfels").integer_in(0, std::int64_t(kAssetMost)));
    return facts;
}

std::optional<double> read_clearance(const Run& run) {
    if (run.folder.empty() || !does_path_exist(run.folder / kAssetFile)) return {};
    return read_description(run.folder).clearance_m;
}

std::vector<fs::path> list_assets(const fs::path& folder) {
    require_folder(folder, "a folder of `relidar assets`");
    std::vector<fs::path> assets = list_folder(folder);
    std::erase_if(assets, [](const fs::path& entry) { return !does_path_exist(entry / kAssetFile); });
    if (assets.empty())
        fail("{} contains no asset, expected folders with an {}", folder.string(), kAssetFile);
    return assets;
}

}  // namespace relidar
