// SPDX-License-Identifier: Apache-2.0
#include "edit/asset_picture.hpp"

#include <algorithm>
#include <cmath>

#include <relidar/simulate/render.hpp>

namespace relidar::cli {
namespace {

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

/// From 0 to 1; -1 means that the pixel shows no surface.
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

}  // namespace

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

}  // namespace relidar::cli
