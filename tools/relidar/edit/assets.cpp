// SPDX-License-Identifier: Apache-2.0
// The command `relidar assets` saves the actors of a run as a folder of assets. A user
// can insert assets into other runs. A client of the render service can add assets to its
// scene.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <set>
#include <system_error>

#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include <relidar/base/images.hpp>
#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/render.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

constexpr double kPixelSize_m = 0.02;
constexpr double kMaxViewWidth_px = 400.0;  // Maximum width of a view in pixels.
constexpr double kBoxMargin_m = 0.3;        // Width of the margin around the asset's box.
constexpr int kViewGap_px = 8;              // Gap between views in pixels.
constexpr std::uint8_t kBackdropGrey = 24;
constexpr float kLeastWeight = 0.5f;

/// viewing direction, right and up in the frame of the object's box
struct CameraAxes {
    glm::dvec3 along, right, up;
};
constexpr int kLeftView = 0, kRightView = 1, kTopView = 2, kBackView = 3, kFrontView = 4;
const CameraAxes kCameraViews[] = {{{0, -1, 0}, {-1, 0, 0}, {0, 0, 1}},
                                   {{0, 1, 0}, {1, 0, 0}, {0, 0, 1}},
                                   {{0, 0, -1}, {1, 0, 0}, {0, 1, 0}},
                                   {{1, 0, 0}, {0, -1, 0}, {0, 0, 1}},
                                   {{-1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

double extent_m(const glm::dvec3& view_axis, const glm::dvec3& box_size_m) {
    return glm::dot(glm::abs(view_axis), box_size_m) + 2.0 * kBoxMargin_m;
}

/// One ray per pixel in the box frame, row by row from the upper left pixel.
RayTable camera_rays(const CameraAxes& camera_axes, const glm::dvec3& box_size_m, double pixel_size_m) {
    RayTable rays;
    rays.rows = int(std::ceil(extent_m(camera_axes.up, box_size_m) / pixel_size_m));
    rays.columns = int(std::ceil(extent_m(camera_axes.right, box_size_m) / pixel_size_m));
    const glm::dvec3 from = -(0.5 * glm::length(box_size_m) + 1.0) * camera_axes.along;
    for (int row = 0; row < rays.rows; ++row) {
        for (int column = 0; column < rays.columns; ++column) {
            const double right_m = (column + 0.5 - 0.5 * rays.columns) * pixel_size_m,
                         up_m = (0.5 * rays.rows - row - 0.5) * pixel_size_m;
            rays.origin.push_back(glm::vec3(from + right_m * camera_axes.right + up_m * camera_axes.up));
            rays.direction.push_back(glm::vec3(camera_axes.along));
            rays.time_offset_s.push_back(0.0f);
            rays.channel.push_back(0);
        }
    }
    return rays;
}

/// Returns the brightness of each pixel from 0 to 1, or -1 if the pixel shows no surface.
/// The constants keep dark and steep surfaces visible.
std::vector<float> brightness_of(const RenderedScan& scan, const CameraAxes& camera_axes,
                                 const glm::dquat& world_from_box, float full_brightness_intensity) {
    std::vector<float> shade(scan.weight.size(), -1.0f);
    const glm::vec3 along(world_from_box * camera_axes.along);
    const auto* normals = find_values<glm::vec3>(scan.channels, "normal");
    for (std::size_t i = 0; i < shade.size(); ++i) {
        if (scan.weight[i] < kLeastWeight) continue;
        const float steep = normals ? std::abs(glm::dot((*normals)[i], along)) : 1.0f;
        shade[i] = (0.3f + 0.7f * std::sqrt(std::clamp(scan.image.intensity[i] / full_brightness_intensity,
                                                       0.0f, 1.0f))) *
                   (0.35f + 0.65f * steep);
    }
    return shade;
}

/// Returns the intensity that only 5 % of the visible pixels exceed. The maximum would
/// make pictures with a few reflectors too dark.
float bright_intensity(const std::vector<RenderedScan>& scans) {
    std::vector<float> values;
    for (const RenderedScan& scan : scans)
        for (std::size_t i = 0; i < scan.weight.size(); ++i)
            if (scan.weight[i] >= kLeastWeight) values.push_back(scan.image.intensity[i]);
    if (values.empty()) return 1.0f;
    const auto high = values.begin() + std::ptrdiff_t(values.size() * 19 / 20);
    std::ranges::nth_element(values, high);
    return std::max(*high, 1e-3f);
}

/// @param top_left_row, top_left_column canvas position of the view's upper left pixel
void draw_asset_view(Image& canvas, int top_left_row, int top_left_column, const RenderedScan& scan,
                     const std::vector<float>& pixel_brightness, const ObservedBoxSurface& surface) {
    for (int r = 0; r < scan.image.rows; ++r) {
        for (int c = 0; c < scan.image.columns; ++c) {
            const auto i = std::size_t(r) * std::size_t(scan.image.columns) + std::size_t(c);
            if (pixel_brightness[i] < 0.0f) continue;
            const bool of_mirror = surface.is_mirror_observed(glm::dvec3(scan.end_of(i)));
            const std::size_t i_canvas = std::size_t(top_left_row + r) * std::size_t(canvas.columns) +
                                         std::size_t(top_left_column + c);
            std::uint8_t* pixel = &canvas.rgb[3 * i_canvas];
            for (int k = 0; k < 3; ++k)
                pixel[k] = std::uint8_t(255.0f * pixel_brightness[i] * (of_mirror && k < 2 ? 0.7f : 1.0f));
        }
    }
}

/// Renders pictures of an asset with parallel rays. The upper row shows the left, right
/// and top sides. The lower row shows the back and the front. The rays are 2 cm apart, or
/// more if the asset is longer than 8 m. A pixel is brighter if its intensity is higher,
/// and darker if the ray meets the surface at a flat angle. Bluish parts were not
/// observed. They are mirrored copies of the other side.
Image draw_asset(Device& device, const ActorAsset& asset, const ObservedBoxSurface& surface) {
    const Run& run = asset.run;
    Config config = run.config;
    config.render.channels = properties_of(run.scene.surfels.primitive).has_normals ? "normal" : "";
    config.sensor.sub_rays = config.sensor.returns = 1;
    ScanRenderer renderer(device, run.scene, config, run.sequence);
    const BoxTrack& box = run.sequence.boxes.front();
    const double pixel_m = std::max(kPixelSize_m, std::max(box.size_m.x, box.size_m.y) / kMaxViewWidth_px),
                 time_s = run.sequence.frames.front().time_s;
    Pose dataset_from_box = box.world_from_box.pose_at(time_s);
    dataset_from_box.translation += run.sequence.world_offset_m;
    const PoseTrack stands{{time_s}, {dataset_from_box}};
    std::vector<RenderedScan> scans;
    for (const CameraAxes& view : kCameraViews)
        scans.push_back(
            renderer.render({.rays = camera_rays(view, box.size_m, pixel_m), .name = "parallel rays"},
                            {time_s, stands, ActorTracksByName{{asset.facts.name, stands}}}));
    const auto rows = [&](int view) { return scans[std::size_t(view)].image.rows; };
    const auto columns = [&](int view) { return scans[std::size_t(view)].image.columns; };
    const int upper = std::max(rows(kLeftView), rows(kTopView));
    Image canvas{upper + rows(kBackView) + 3 * kViewGap_px,
                 columns(kLeftView) + columns(kRightView) + columns(kTopView) + 4 * kViewGap_px,
                 {}};
    canvas.rgb.assign(3 * std::size_t(canvas.rows) * std::size_t(canvas.columns), kBackdropGrey);
    const int second = 2 * kViewGap_px + columns(kLeftView),
              third = second + kViewGap_px + columns(kRightView), below = upper + 2 * kViewGap_px;
    const int view_positions_px[][2] = {{kViewGap_px, kViewGap_px},
                                        {kViewGap_px, second},
                                        {kViewGap_px, third},
                                        {below, kViewGap_px},
                                        {below, second}};
    const float brightest = bright_intensity(scans);
    for (std::size_t v = 0; v < scans.size(); ++v)
        draw_asset_view(canvas, view_positions_px[v][0], view_positions_px[v][1], scans[v],
                        brightness_of(scans[v], kCameraViews[v], dataset_from_box.rotation, brightest),
                        surface);
    return canvas;
}

struct AssetOptions {
    std::string run;
    std::string out;
    double least = 0.5;
    DeviceCommandOptions device;
    bool quiet = false;
};

/// Returns why an actor was observed too little to be saved, or an empty text.
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

/// Returns one track for each model of an actor.
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

void add_assets(CLI::App& app, ParsedCommand& call) {
    CLI::App* command =
        app.add_subcommand("assets", "save well-observed actors of a run for use in other runs");
    const auto options = std::make_shared<AssetOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train` or `relidar edit`")->required();
    add_option(*command, "--out FOLDER", options->out, "new folder; each asset becomes a subfolder")
        ->required();
    add_option(*command, "--least SCORE", options->least, "minimum score of an actor, 0 to 1 (default: 0.5)");
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->quiet);
    command->footer(kAssetsHelp);
    command->callback([&call, options] { call.run = [options] { run_assets(*options); }; });
}

}  // namespace relidar::cli
