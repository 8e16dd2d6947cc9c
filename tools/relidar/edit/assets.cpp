// SPDX-License-Identifier: Apache-2.0
// The command `relidar assets` saves the actors of a run as a folder of assets. A user
// can insert assets into other runs. A client of the render service can add assets to its
// scene.
#include <filesystem>
#include <memory>
#include <set>
#include <system_error>

#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include <relidar/base/images.hpp>
#include <relidar/simulate/assets.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "edit/asset_picture.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

struct AssetOptions {
    std::string run;
    std::string out;
    double least = 0.5;
    DeviceCommandOptions device;
    bool quiet = false;
};

std::string why_not_saved(const AssetDescription& asset, const ActorObservations& seen, double min_covered) {
    if (seen.points_m.empty()) return "no ray of the training frames hits this actor";
    if (asset.covered_share() >= min_covered) return "";
    std::string side_shares;
    for (std::size_t s = 0; s < kBoxSides; ++s)
        side_shares += fmt::format("{}{} {:.2f}", s ? ", " : "", name_of(BoxSide(s)), asset.seen_sides[s]);
    return fmt::format(
        "the score of the actor is {:.2f}, expected at least {:.2f} (--least); share of each side that rays "
        "of the log hit: {}{}",
        asset.covered_share(), min_covered, side_shares,
        asset.completed > 0.0
            ? fmt::format("; mirroring completed a share of {:.2f} of its surface", asset.completed)
            : "");
}

std::vector<std::string> list_track_ids(const Run& run) {
    std::vector<std::string> tracks;
    // A copy of an actor has the same model, so it is skipped.
    std::set<std::uint32_t> models;
    for (const ModelInstance& instance : run.scene.instances)
        if (!instance.track.empty() && models.insert(instance.model).second) tracks.push_back(instance.track);
    if (tracks.empty())
        fail<UsageError>("run {} has no actor; expected at least one actor to save", run.folder.string());
    return tracks;
}

/// Names can collide, because characters that are not allowed in folder names are
/// replaced.
void make_unique_name(ActorAsset& asset, std::set<std::string>& used_names) {
    const std::string stem = asset.facts.name;
    std::string name = stem;
    for (int n = 2; !used_names.insert(name).second; ++n) name = fmt::format("{}-{}", stem, n);
    if (name == stem) return;
    asset.facts.name = asset.run.scene.models[1].name = asset.run.scene.instances[1].track =
        asset.run.sequence.boxes[0].id = name;
}

std::vector<std::string> format_asset_row(const AssetDescription& asset_description) {
    std::vector<std::string> row{asset_description.name, asset_description.category,
                                 fmt::format("{:.2f}", asset_description.covered_share())};
    for (const double side : asset_description.seen_sides) row.push_back(fmt::format("{:.2f}", side));
    for (const double value : {asset_description.completed, asset_description.nearest_m})
        row.push_back(fmt::format("{:.2f}", value));
    row.push_back(fmt::format("{}", asset_description.surfels));
    return row;
}

void run_assets(const AssetOptions& options) {
    if (!(options.least >= 0.0 && options.least <= 1.0))
        fail<UsageError>("--least: found {}; expected a number from 0 to 1", options.least);
    std::error_code failed;
    if (fs::exists(options.out, failed) && !fs::is_empty(options.out, failed))
        fail<UsageError>("--out {}: the folder is not empty, expected a new or empty folder", options.out);
    const StagedFolder folder(options.out);
    const Run run = load_run(options.run);
    const std::vector<std::string> tracks = list_track_ids(run);
    Device device(to_device_options(options.device));
    TerminalProgress progress(options.quiet);
    const std::map<std::string, ActorObservations> sightings =
        observe_actors(device, run, progress_callback(progress));
    std::vector<std::vector<std::string>> rows{{"asset", "class", "score", "front", "rear", "left", "right",
                                                "top", "mirrored", "nearest_m", "surfels"}};
    std::set<std::string> used_names;
    std::string skipped, best_skipped;
    double highest_score = -1.0;
    for (const std::string& track : tracks) {
        const auto match = sightings.find(track);
        const ActorObservations actor_sightings =
            match == sightings.end() ? ActorObservations{} : match->second;
        ActorAsset asset = extract_asset(run, track, actor_sightings);
        if (const std::string reason = why_not_saved(asset.facts, actor_sightings, options.least);
            !reason.empty()) {
            const std::string text = fmt::format("{} ({}): {}", track, asset.facts.category, reason);
            skipped += "skipped " + text + "\n";
            if (const double score = asset.facts.covered_share(); score > highest_score) {
                highest_score = score;
                best_skipped = text;
            }
            continue;
        }
        make_unique_name(asset, used_names);
        save_asset(asset, folder.path() / asset.facts.name);
        const Image views = draw_asset(device, asset, observed_surface(asset.facts.size_m, actor_sightings));
        write_png(folder.path() / asset.facts.name / "views.png", views);
        rows.push_back(format_asset_row(asset.facts));
    }
    end_progress();
    if (rows.size() == 1)
        fail(
            "no asset is saved, because none of the {} actors of run {} has a sufficient score; the best "
            "one: {}",
            tracks.size(), options.run, make_one_line(best_skipped));
    folder.replace_folder();
    if (options.quiet) return;
    print(format_table(rows) + skipped +
          fmt::format("saved {} of {} actors in {}\n", rows.size() - 1, tracks.size(), options.out));
}

constexpr const char* kAssetsHelp =
    R"(The score of an actor is the share of its surface (sides and top of its box) that rays of the
training frames hit. For vehicles the score includes parts completed by the mirror image of the
other side. Each asset is a complete run with asset.json (class, size, score) and views.png. The
picture shows the asset from left, right, above, behind and ahead; mirrored parts are bluish.
Examples:
  relidar assets run --out assets
  relidar edit other --out busy --insert assets/car-3@12,3.5,0.9,180
  relidar serve other --assets assets)";

}  // namespace

void add_assets(CLI::App& app, ParsedCommand& selected_command) {
    CLI::App* command =
        app.add_subcommand("assets", "save well-observed actors of a run for use in other runs");
    const auto options = std::make_shared<AssetOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train` or `relidar edit`")->required();
    command->add_option("--out", options->out, "new folder; each asset becomes a subfolder")
        ->required()
        ->type_name("FOLDER");
    command->add_option("--least", options->least, "minimum score of an actor, 0 to 1 (default: 0.5)")
        ->type_name("SCORE");
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->quiet);
    command->footer(kAssetsHelp);
    command->callback(
        [&selected_command, options] { selected_command.run = [options] { run_assets(*options); }; });
}

}  // namespace relidar::cli
