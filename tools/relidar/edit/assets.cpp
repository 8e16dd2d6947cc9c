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
// A pixel with less blending weight shows no surface.
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

/// Returns parallel rays for a picture of a box: one ray per pixel in the box frame, row
/// by row from the upper left pixel. They start 1 m outside the sphere around the box.
RayTable camera_rays(const CameraAxes& camera_axes, const glm::dvec3& box_size_m, double pixel_size_m) {
    RayTable rays;
    rays.rows = int(std::ceil(extent_m(camera_axes.up, box_size_m) / pixel_size_m));
    rays.columns = int(std::ceil(extent_m(camera_axes.right, box_size_m) / pixel_size_m));
    const glm::dvec3 centre_m = -(0.5 * glm::length(box_size_m) + 1.0) * camera_axes.along;
    for (int row = 0; row < rays.rows; ++row) {
        for (int column = 0; column < rays.columns; ++column) {
            const double right_m = (column + 0.5 - 0.5 * rays.columns) * pixel_size_m,
                         up_m = (0.5 * rays.rows - row - 0.5) * pixel_size_m;
            rays.origin.push_back(glm::vec3(centre_m + right_m * camera_axes.right + up_m * camera_axes.up));
            rays.direction.push_back(glm::vec3(camera_axes.along));
            rays.time_offset_s.push_back(0.0f);
            rays.channel.push_back(0);
        }
    }
    return rays;
}

/// Returns the brightness of each pixel from 0 to 1, or -1 if the pixel shows no surface.
/// It is higher for a higher intensity, and lower if the ray meets the surface at a flat
/// angle. The additive constants keep dark and steep surfaces visible.
std::vector<float> brightness_of(const RenderedScan& scan, const CameraAxes& camera_axes,
                                 const glm::dquat& world_from_box, float full_brightness_intensity) {
    std::vector<float> brightness(scan.weight.size(), -1.0f);
    const glm::vec3 along(world_from_box * camera_axes.along);
    const auto* normals = find_values<glm::vec3>(scan.channels, "normal");
    for (std::size_t i = 0; i < brightness.size(); ++i) {
        if (scan.weight[i] < kLeastWeight) continue;
        const float intensity = std::clamp(scan.image.intensity[i] / full_brightness_intensity, 0.0f, 1.0f);
        const float cos_incidence = normals ? std::abs(glm::dot((*normals)[i], along)) : 1.0f;
        brightness[i] = (0.3f + 0.7f * std::sqrt(intensity)) * (0.35f + 0.65f * cos_incidence);
    }
    return brightness;
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

struct CanvasPosition {
    int row, column;
};

/// Draws a view of an asset on the canvas. Parts that were not observed, but copied from
/// the mirrored other side, are bluish: they have less red and green.
void draw_asset_view(Image& canvas, const CanvasPosition& top_left, const RenderedScan& scan,
                     const std::vector<float>& pixel_brightness, const ObservedBoxSurface& surface) {
    for (int row = 0; row < scan.image.rows; ++row) {
        for (int column = 0; column < scan.image.columns; ++column) {
            const auto i = std::size_t(row) * std::size_t(scan.image.columns) + std::size_t(column);
            if (pixel_brightness[i] < 0.0f) continue;
            const bool is_mirrored = surface.is_mirror_observed(glm::dvec3(scan.end_of(i)));
            const float red_green = is_mirrored ? 0.7f : 1.0f;
            const std::size_t i_canvas = std::size_t(top_left.row + row) * std::size_t(canvas.columns) +
                                         std::size_t(top_left.column + column);
            std::uint8_t* rgb = &canvas.rgb[3 * i_canvas];
            rgb[0] = rgb[1] = std::uint8_t(255.0f * pixel_brightness[i] * red_green);
            rgb[2] = std::uint8_t(255.0f * pixel_brightness[i]);
        }
    }
}

/// Renders an asset with parallel rays in all kCameraViews. The rays are 2 cm apart, or
/// more if the asset is longer than 8 m.
std::vector<RenderedScan> render_views(Device& device, const ActorAsset& asset, double time_s,
                                       const Pose& dataset_from_box) {
    const Run& run = asset.run;
    Config config = run.config;
    const bool has_normals = properties_of(run.scene.surfels.primitive).has_normals;
    config.render.channels = has_normals ? "normal" : "";  // for brightness_of()
    config.sensor.sub_rays = config.sensor.returns = 1;
    ScanRenderer renderer(device, run.scene, config, run.log);
    const glm::dvec3& size_m = run.log.boxes.front().size_m;
    const double pixel_m = std::max(kPixelSize_m, std::max(size_m.x, size_m.y) / kMaxViewWidth_px);
    // The sensor and the asset have the same pose, so camera_rays() are in the box frame.
    const PoseTrack pose{{time_s}, {dataset_from_box}};
    const ScanRequest request{time_s, pose, ActorTracksByName{{asset.facts.name, pose}}};
    std::vector<RenderedScan> scans;
    for (const CameraAxes& view : kCameraViews)
        scans.push_back(
            renderer.render({.rays = camera_rays(view, size_m, pixel_m), .name = "parallel rays"}, request));
    return scans;
}

/// Draws pictures of an asset. The upper row shows the left, right and top sides. The
/// lower row shows the back and the front.
Image draw_asset(Device& device, const ActorAsset& asset, const ObservedBoxSurface& surface) {
    const Log& log = asset.run.log;
    const double time_s = log.frames.front().time_s;
    Pose dataset_from_box = log.boxes.front().world_from_box.pose_at(time_s);
    dataset_from_box.translation += log.world_offset_m;
    const std::vector<RenderedScan> scans = render_views(device, asset, time_s, dataset_from_box);

    const auto rows = [&](int view) { return scans[std::size_t(view)].image.rows; };
    const auto columns = [&](int view) { return scans[std::size_t(view)].image.columns; };
    // Pixel positions of the pictures. The left and the right picture have equal sizes.
    constexpr int kFirstRow = kViewGap_px, kFirstColumn = kViewGap_px;
    const int second_column = kFirstColumn + columns(kLeftView) + kViewGap_px;
    const int third_column = second_column + columns(kRightView) + kViewGap_px;
    const int second_row = kFirstRow + std::max(rows(kLeftView), rows(kTopView)) + kViewGap_px;
    // In the order of kCameraViews: left, right, top, back, front.
    const CanvasPosition top_left_of_view[] = {{.row = kFirstRow, .column = kFirstColumn},
                                               {.row = kFirstRow, .column = second_column},
                                               {.row = kFirstRow, .column = third_column},
                                               {.row = second_row, .column = kFirstColumn},
                                               {.row = second_row, .column = second_column}};
    Image canvas{.rows = second_row + rows(kBackView) + kViewGap_px,
                 .columns = third_column + columns(kTopView) + kViewGap_px,
                 .rgb = {}};
    canvas.rgb.assign(3 * std::size_t(canvas.rows) * std::size_t(canvas.columns), kBackdropGrey);
    const float brightest = bright_intensity(scans);
    for (std::size_t view = 0; view < scans.size(); ++view)
        draw_asset_view(canvas, top_left_of_view[view], scans[view],
                        brightness_of(scans[view], kCameraViews[view], dataset_from_box.rotation, brightest),
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
    std::string reason = fmt::format(
        "the score of the actor is {:.2f}, expected at least {:.2f} (--least); share of each side that rays "
        "of the log hit: {}",
        asset.covered_share(), min_covered, side_shares);
    if (asset.completed > 0.0)
        reason += fmt::format("; mirroring completed a share of {:.2f} of its surface", asset.completed);
    return reason;
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

/// Appends a number to the name of an asset if another asset has this name. Names can
/// collide, because characters that are not allowed in folder names are replaced.
void make_unique_name(ActorAsset& asset, std::set<std::string>& used_names) {
    const std::string stem = asset.facts.name;
    std::string name = stem;
    for (int n = 2; !used_names.insert(name).second; ++n) name = fmt::format("{}-{}", stem, n);
    if (name == stem) return;
    asset.facts.name = asset.run.scene.models[1].name = asset.run.scene.instances[1].track =
        asset.run.log.boxes[0].id = name;
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

struct SkippedActors {
    std::string lines;  ///< a line for each actor that is not saved
    std::string best;   ///< text of the actor with the highest score
    double highest_score = -1.0;

    void add_actor(const std::string& track, const AssetDescription& asset, const std::string& reason) {
        const std::string text = fmt::format("{} ({}): {}", track, asset.category, reason);
        lines += "skipped " + text + "\n";
        if (asset.covered_share() <= highest_score) return;
        highest_score = asset.covered_share();
        best = text;
    }
};

/// Saves each actor of a run that was observed well enough as an asset with a picture.
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
    const std::map<std::string, ActorObservations> observations_by_track =
        observe_actors(device, run, progress_callback(progress));

    TableRows rows{{"asset", "class", "score", "front", "rear", "left", "right", "top", "mirrored",
                    "nearest_m", "surfels"}};
    std::set<std::string> used_names;
    SkippedActors skipped;
    for (const std::string& track : tracks) {
        const auto match = observations_by_track.find(track);
        const ActorObservations seen =
            match == observations_by_track.end() ? ActorObservations{} : match->second;
        ActorAsset asset = extract_asset(run, track, seen);
        if (const std::string reason = why_not_saved(asset.facts, seen, options.least); !reason.empty()) {
            skipped.add_actor(track, asset.facts, reason);
            continue;
        }
        make_unique_name(asset, used_names);
        save_asset(asset, folder.path() / asset.facts.name);
        write_png(folder.path() / asset.facts.name / "views.png",
                  draw_asset(device, asset, observed_surface(asset.facts.size_m, seen)));
        rows.push_back(format_asset_row(asset.facts));
    }
    end_progress();

    const std::size_t n_saved = rows.size() - 1;  // without the titles
    if (n_saved == 0)
        fail(
            "no asset is saved, because none of the {} actors of run {} has a sufficient score; the best "
            "one: {}",
            tracks.size(), options.run, make_one_line(skipped.best));
    folder.replace_folder();
    if (options.quiet) return;
    print(format_table(rows) + skipped.lines +
          fmt::format("saved {} of {} actors in {}\n", n_saved, tracks.size(), options.out));
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

/// Adds the command `relidar assets` and its options to the parser.
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
    run_after_parsing(*command, call, options, run_assets);
}

}  // namespace relidar::cli
