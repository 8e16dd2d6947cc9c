// SPDX-License-Identifier: Apache-2.0
#include "evaluate/walking_strip.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include <relidar/log/sensor.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::cli {
namespace {

// Number of frames to draw, and minimum mean number of the actor's points per frame.
constexpr std::size_t kFrames = 8, kFewestPoints = 20;
constexpr double kPixels_per_m = 80.0, kBeside_m = 0.25, kWider_m = 0.5;
constexpr int kDot = 3;

/// Returns the rays of a frame that may hit the box, as a list without image rows and
/// columns.
Scan make_rays_about_box(const Run& run, const Frame& frame, const BoxTrack& box) {
    const Pose sensor =
        run.sequence.world_from_vehicle.at(frame.time_s, run.sequence.get_lidar(frame).vehicle_from_sensor);
    const glm::dvec3 about = inverse(sensor) * box.world_from_box.at(frame.time_s).translation;
    const double distance = glm::length(about), reach = 0.5 * glm::length(box.size_m) + kWider_m;
    const double cosine = distance > reach ? std::cos(std::asin(reach / distance)) : -1.0;
    std::vector<std::size_t> ray_indices;
    for (std::size_t i = 0; i < frame.scan.rays.size(); ++i)
        if (glm::dot(glm::dvec3(frame.scan.rays.direction[i]), about) > cosine * distance)
            ray_indices.push_back(i);
    Scan scan{select_rays(frame.scan.rays, ray_indices), {}, {}};
    for (const std::size_t i : ray_indices) {
        scan.range_m.push_back(frame.scan.range_m[i]);
        scan.intensity.push_back(frame.scan.intensity[i]);
    }
    return scan;
}

/// Returns the frames of the first LiDAR in which the box is present. Frames without a
/// scan are skipped.
std::vector<const Frame*> frames_of(const Run& run, const BoxTrack& box) {
    std::vector<const Frame*> frames;
    for (const Frame& frame : run.sequence.frames)
        if (frame.lidar == 0 && frame.scan.range_m.size() > 0 && box.present(frame.time_s))
            frames.push_back(&frame);
    return frames;
}

double compute_distance(const Run& run, const Frame& frame, const BoxTrack& box) {
    return glm::distance(run.sequence.world_from_vehicle.at(frame.time_s).translation,
                         box.world_from_box.at(frame.time_s).translation);
}

struct Walk {
    const BoxTrack* box = nullptr;
    std::vector<const Frame*> frames;
    /// Mean distance between the actor and the sensor.
    double distance_m = std::numeric_limits<double>::max();
};

/// Finds the walking actor that comes nearest to the sensor, and the frames in which it
/// is nearest. Near actors have the most points.
Walk find_nearest_walk(const Run& run) {
    Walk nearest;
    for (const Instance& instance : run.scene.instances) {
        const BoxTrack* box = find_box(run.sequence, instance.track);
        if (!box || !(run.scene.models[std::size_t(instance.model)].stride_m > 0.0f)) continue;
        const std::vector<const Frame*> frames = frames_of(run, *box);
        for (std::size_t first = 0; first + kFrames <= frames.size(); ++first) {
            const std::vector<const Frame*> some(frames.begin() + std::ptrdiff_t(first),
                                                 frames.begin() + std::ptrdiff_t(first + kFrames));
            double sum = 0.0;
            for (const Frame* frame : some) sum += compute_distance(run, *frame, *box);
            if (sum / double(kFrames) < nearest.distance_m) nearest = {box, some, sum / double(kFrames)};
        }
    }
    return nearest;
}

/// Draws several point clouds side by side, with one dot per point. The actor faces to
/// the right. The colour shows how far left or right a point is on the body.
Image draw_panels(const std::vector<std::vector<glm::dvec3>>& panels, const glm::dvec3& size_m) {
    const int width = int((size_m.x + 2.0 * kBeside_m) * kPixels_per_m),
              rows = int((size_m.z + 2.0 * kBeside_m) * kPixels_per_m);
    const int columns = width * int(panels.size());
    std::vector<float> left(std::size_t(rows) * std::size_t(columns),
                            std::numeric_limits<float>::quiet_NaN());
    for (std::size_t k = 0; k < panels.size(); ++k)
        for (const glm::dvec3& p : panels[k]) {
            const int x = int((p.x + 0.5 * size_m.x + kBeside_m) * kPixels_per_m);
            const int y = int((0.5 * size_m.z + kBeside_m - p.z) * kPixels_per_m);
            for (int row = std::max(y, 0); row < std::min(y + kDot, rows); ++row)
                for (int column = std::max(x, 0); column < std::min(x + kDot, width - 1); ++column)
                    left[std::size_t(row) * std::size_t(columns) + k * std::size_t(width) +
                         std::size_t(column)] = float(p.y);
        }
    const float half = float(0.5 * size_m.y);
    return apply_colour_map(left, rows, columns, -half, half, "turbo");
}

}  // namespace

std::optional<ReportFigure> draw_walking_strip(Device& device, const Run& run) {
    const Walk walk = find_nearest_walk(run);
    if (!walk.box) return std::nullopt;
    Config config = run.config;
    config.sensor.grid = "native";
    config.sensor.sub_rays = config.sensor.returns = 1;
    ScanRenderer renderer(device, run.scene, config, run.sequence);
    std::vector<std::vector<glm::dvec3>> real, simulated;
    std::size_t n = 0;
    for (const Frame* frame : walk.frames) {
        const Scan scan = make_rays_about_box(run, *frame, *walk.box);
        const RangeImage measured = make_real_image(config, scan);
        SensorChoice sensor = make_configured_sensor(config, run.sequence, frame->lidar);
        sensor.rays = scan.rays;
        sensor.follows_sweeps = false;
        sensor.rolling_shutter = run.sequence.rolling_shutter;
        const RenderedScan rendered = renderer.render(sensor, frame->time_s);
        const BoxPoints points =
            collect_points_in_box(rendered.image, select_point_ranges(rendered, config), measured,
                                  run.sequence, get_sweep_moment(*frame), *walk.box);
        n += points.real_m.size();
        real.push_back(points.real_m);
        simulated.push_back(points.simulated_m);
    }
    if (n < kFrames * kFewestPoints) return std::nullopt;
    return ReportFigure{
        fmt::format("{} {} {}, {:.0f} m away: successive frames, including training frames, seen from the "
                    "right, coloured from right to left",
                    walk.box->category, walk.box->id,
                    parse_object_kind(walk.box->category) == ObjectKind::cyclist ? "rides" : "walks",
                    walk.distance_m),
        {{"real", draw_panels(real, walk.box->size_m)},
         {"simulated", draw_panels(simulated, walk.box->size_m)}}};
}

}  // namespace relidar::cli
