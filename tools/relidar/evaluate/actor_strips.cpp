// SPDX-License-Identifier: Apache-2.0
#include "evaluate/actor_strips.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include <fmt/format.h>

#include <relidar/log/sensor.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/simulate/render.hpp>
#include "interrupt.hpp"

namespace relidar::cli {
namespace {

// A picture shows one actor in up to kStripFrames frames, side by side. Actors with fewer
// than kMinPointsPerFrame points per frame on average are not drawn.
constexpr std::size_t kStripFrames = 8, kMinPointsPerFrame = 20;
// Margin around the box in a picture, and around the sphere in which rays are selected.
constexpr double kPixels_per_m = 80.0, kBeside_m = 0.25, kWider_m = 0.5;
constexpr int kDotSize_px = 3;
constexpr float kErrorScale_m = 0.3f;  // distance that the brightest colour of the error shows

/// Returns the rays of a frame that may hit a box, with their real returns, so that only
/// these are rendered: all rays in the cone around the sphere that contains the box.
Scan rays_near_box(const Run& run, const Frame& frame, const BoxTrack& box) {
    const Pose sensor =
        run.log.world_from_vehicle.mounted_pose_at(frame.time_s, run.log.lidar_of(frame).vehicle_from_sensor);
    const glm::dvec3 centre_m = inverse(sensor) * box.world_from_box.pose_at(frame.time_s).translation;
    const double distance_m = glm::length(centre_m), radius_m = 0.5 * glm::length(box.size_m) + kWider_m;
    // A sensor inside the sphere needs the rays in all directions.
    const double cone_cosine = distance_m > radius_m ? std::cos(std::asin(radius_m / distance_m)) : -1.0;
    std::vector<std::size_t> ray_indices;
    // For a unit vector, direction . centre = distance cos(angle).
    for (std::size_t i = 0; i < frame.scan.rays.size(); ++i)
        if (glm::dot(glm::dvec3(frame.scan.rays.direction[i]), centre_m) > cone_cosine * distance_m)
            ray_indices.push_back(i);
    Scan scan{select_rays(frame.scan.rays, ray_indices), {}, {}};
    for (const std::size_t i : ray_indices) {
        scan.range_m.push_back(frame.scan.range_m[i]);
        scan.intensity.push_back(frame.scan.intensity[i]);
    }
    return scan;
}

struct WalkingActorFrames {
    const BoxTrack* box = nullptr;
    std::vector<const Frame*> frames;
    /// between the actor and the vehicle
    double distance_m = std::numeric_limits<double>::max();
};

/// Returns the scans of the first LiDAR while a box is present.
std::vector<const Frame*> frames_of_box(const Log& log, const BoxTrack& box) {
    std::vector<const Frame*> frames;
    for (const Frame& frame : log.frames)
        if (frame.lidar == 0 && frame.scan.range_m.size() > 0 && box.is_observed(frame.time_s))
            frames.push_back(&frame);
    return frames;
}

double mean_distance_m(const Log& log, std::span<const Frame* const> frames, const BoxTrack& box) {
    double sum_m = 0.0;
    for (const Frame* frame : frames)
        sum_m += glm::distance(log.world_from_vehicle.pose_at(frame->time_s).translation,
                               box.world_from_box.pose_at(frame->time_s).translation);
    return sum_m / double(frames.size());
}

/// Finds the walking actor that comes nearest to the vehicle, and the eight successive
/// frames in which it is nearest. Only models of walking actors have a stride.
WalkingActorFrames nearest_walker(const Run& run) {
    WalkingActorFrames nearest;
    for (const ModelInstance& instance : run.scene.instances) {
        const BoxTrack* box = find_box(run.log, instance.track);
        const bool walks = run.scene.models[std::size_t(instance.model)].stride_m > 0.0f;
        if (!box || !walks) continue;
        const std::vector<const Frame*> frames = frames_of_box(run.log, *box);
        for (std::size_t first = 0; first + kStripFrames <= frames.size(); ++first) {
            const std::span successive = std::span(frames).subspan(first, kStripFrames);
            const double distance_m = mean_distance_m(run.log, successive, *box);
            if (distance_m < nearest.distance_m)
                nearest = {box, {successive.begin(), successive.end()}, distance_m};
        }
    }
    return nearest;
}

/// `value` is shown as colour.
struct PictureDot {
    double right_m, up_m;
    float value;
};

/// Draws several sets of dots side by side.
/// @param panel_half_size_m half width and half height of each panel, metres
/// @param min_value at the lower end of the colour map; `max_value` is at the upper end
Image draw_panels(const std::vector<std::vector<PictureDot>>& dots_of_each_panel,
                  const glm::dvec2& panel_half_size_m, float min_value, float max_value,
                  const char* colour_map_name) {
    const int panel_width = int(2.0 * (panel_half_size_m.x + kBeside_m) * kPixels_per_m),
              rows = int(2.0 * (panel_half_size_m.y + kBeside_m) * kPixels_per_m);
    const int columns = panel_width * int(dots_of_each_panel.size());
    // NaN is shown as background. The last column of a panel stays empty, as a gap.
    std::vector<float> values(std::size_t(rows) * std::size_t(columns),
                              std::numeric_limits<float>::quiet_NaN());
    for (std::size_t panel = 0; panel < dots_of_each_panel.size(); ++panel)
        for (const PictureDot& dot : dots_of_each_panel[panel]) {
            const int left = int((dot.right_m + panel_half_size_m.x + kBeside_m) * kPixels_per_m);
            const int top = int((panel_half_size_m.y + kBeside_m - dot.up_m) * kPixels_per_m);
            const int right = std::min(left + kDotSize_px, panel_width - 1);
            for (int row = std::max(top, 0); row < std::min(top + kDotSize_px, rows); ++row)
                for (int column = std::max(left, 0); column < right; ++column) {
                    const std::size_t first_of_panel =
                        std::size_t(row) * std::size_t(columns) + panel * std::size_t(panel_width);
                    values[first_of_panel + std::size_t(column)] = dot.value;
                }
        }
    return apply_colour_map(values, rows, columns, min_value, max_value, colour_map_name);
}

/// Projects the points of an actor into a side view along `direction`. The value of a dot
/// is its depth along this direction, relative to the centre of the box. The right side
/// of a viewer who looks along (x, y) is (y, -x).
std::vector<PictureDot> project_dots(const std::vector<glm::dvec3>& points_m, const glm::dvec2& direction) {
    std::vector<PictureDot> dots;
    for (const glm::dvec3& p : points_m)
        dots.push_back(
            {direction.y * p.x - direction.x * p.y, p.z, float(direction.x * p.x + direction.y * p.y)});
    return dots;
}

/// Renders exactly the recorded rays of a frame that may hit an actor. Returns the
/// recorded and the rendered points in the actor's box.
MovingBoxPoints box_points(ScanRenderer& renderer, const Run& run, const Config& config, const Frame& frame,
                           const BoxTrack& box) {
    const Scan scan = rays_near_box(run, frame, box);
    if (scan.rays.size() == 0) return {};
    check_interrupt();
    SimulatedSensor sensor = make_sensor(config, run.log, frame.lidar);
    sensor.rays = scan.rays;
    sensor.follows_sweeps = false;  // The rays are those of this sweep, so they must not change.
    sensor.rolling_shutter = run.log.rolling_shutter;
    const RenderedScan rendered = renderer.render(sensor, frame.time_s);
    return points_in_box(rendered.image, point_ranges(rendered, config), measured_image(config, scan),
                         run.log, timing_of(frame), box);
}

/// One traced ray and at most one return per beam.
Config picture_config(const Run& run) {
    Config config = run.config;
    config.sensor.grid = "native";
    config.sensor.sub_rays = config.sensor.returns = 1;
    return config;
}

/// Dots of an actor, with one panel per frame.
struct ActorPanels {
    std::vector<std::vector<PictureDot>> real, simulated;
    std::size_t n_real_points = 0;

    void add_frame(const MovingBoxPoints& points, const glm::dvec2& direction) {
        n_real_points += points.real_m.size();
        real.push_back(project_dots(points.real_m, direction));
        simulated.push_back(project_dots(points.simulated_m, direction));
    }
    bool has_enough_points() const {
        return !real.empty() && n_real_points >= real.size() * kMinPointsPerFrame;
    }
};

/// Returns the horizontal direction from the sensor to a box, in the frame of the box.
glm::dvec2 viewing_direction(const Log& log, const Frame& frame, const BoxTrack& box) {
    const glm::dvec3 sensor_m = log.lidar_track(frame.lidar).pose_at(frame.time_s).translation;
    const glm::dvec2 sensor_in_box_m(inverse(box.world_from_box.pose_at(frame.time_s)) * sensor_m);
    return -sensor_in_box_m / std::max(glm::length(sensor_in_box_m), 1e-6);
}

/// Returns the simulated points with their distance to the nearest real point, metres.
std::vector<PictureDot> error_dots(std::vector<PictureDot> simulated_dots, const MovingBoxPoints& points) {
    for (std::size_t i = 0; i < simulated_dots.size(); ++i) {
        double nearest_m = std::numeric_limits<double>::max();
        for (const glm::dvec3& real_m : points.real_m)
            nearest_m = std::min(nearest_m, glm::distance(points.simulated_m[i], real_m));
        simulated_dots[i].value = float(nearest_m);
    }
    return simulated_dots;
}

/// Draws an actor in some held-out frames, as the sensor sees it. Returns nothing if the
/// actor has too few real points.
std::optional<ReportFigure> draw_actor(ScanRenderer& renderer, const Run& run, const Config& config,
                                       const ActorScore& actor) {
    const BoxTrack* box = find_box(run.log, actor.track);
    if (!box) return std::nullopt;
    ActorPanels panels;
    std::vector<std::vector<PictureDot>> errors;
    for (const int position : run.split.test) {
        const Frame& frame = run.log.frames[std::size_t(position)];
        if (panels.real.size() == kStripFrames) break;
        if (frame.scan.range_m.empty() || !box->is_observed(frame.time_s)) continue;
        const MovingBoxPoints points = box_points(renderer, run, config, frame, *box);
        if (points.real_m.empty() && points.simulated_m.empty()) continue;
        panels.add_frame(points, viewing_direction(run.log, frame, *box));
        errors.push_back(error_dots(panels.simulated.back(), points));
    }
    if (!panels.has_enough_points()) return std::nullopt;

    // The box is seen from any side, so its width in the picture is at most its diagonal.
    const double radius_m = 0.5 * std::hypot(box->size_m.x, box->size_m.y);
    const glm::dvec2 half_m(radius_m, 0.5 * box->size_m.z);
    const auto max_depth_m = float(radius_m);
    return ReportFigure{
        fmt::format("{} {}: held-out frames, as the sensor sees them, coloured by distance", actor.category,
                    actor.track),
        {{"real", draw_panels(panels.real, half_m, -max_depth_m, max_depth_m, "turbo")},
         {"simulated", draw_panels(panels.simulated, half_m, -max_depth_m, max_depth_m, "turbo")},
         {fmt::format("distance of simulated points from the nearest real point, 0 to {} m", kErrorScale_m),
          draw_panels(errors, half_m, 0.0f, kErrorScale_m, "heat")}}};
}

}  // namespace

std::optional<ReportFigure> draw_walker(Device& device, const Run& run) {
    const WalkingActorFrames walker = nearest_walker(run);
    if (!walker.box) return std::nullopt;
    const BoxTrack& box = *walker.box;
    const Config config = picture_config(run);
    ScanRenderer renderer(device, run.scene, config, run.log);
    // A viewer at the right side of the actor looks along y of its box.
    const glm::dvec2 view_direction(0.0, 1.0);
    ActorPanels panels;
    for (const Frame* frame : walker.frames)
        panels.add_frame(box_points(renderer, run, config, *frame, box), view_direction);
    if (!panels.has_enough_points()) return std::nullopt;

    const glm::dvec2 half_m(0.5 * box.size_m.x, 0.5 * box.size_m.z);
    const float max_depth_m = float(0.5 * box.size_m.y);
    const char* motion = parse_kind(box.category) == ObjectKind::cyclist ? "rides" : "walks";
    return ReportFigure{
        fmt::format("{} {} {}, {:.0f} m away: successive frames, including training frames, seen from the "
                    "right side of the actor; colour: depth, from blue (right side) to red (left side)",
                    box.category, box.id, motion, walker.distance_m),
        {{"real", draw_panels(panels.real, half_m, -max_depth_m, max_depth_m, "turbo")},
         {"simulated", draw_panels(panels.simulated, half_m, -max_depth_m, max_depth_m, "turbo")}}};
}

std::vector<ReportFigure> draw_worst_actors(Device& device, const Run& run, const Evaluation& result) {
    constexpr std::size_t kMaxFigures = 3;
    const Config config = picture_config(run);
    ScanRenderer renderer(device, run.scene, config, run.log);
    std::vector<ReportFigure> figures;
    // The worst actor is first.
    for (const ActorScore& actor : result.actors) {
        if (figures.size() == kMaxFigures) break;
        if (std::optional<ReportFigure> figure = draw_actor(renderer, run, config, actor))
            figures.push_back(std::move(*figure));
    }
    return figures;
}

void write_worst_actors(const std::filesystem::path& folder, Device& device, const Run& run,
                        const Evaluation& result) {
    constexpr std::size_t kMaxActors = 20;
    const Config config = picture_config(run);
    ScanRenderer renderer(device, run.scene, config, run.log);
    for (std::size_t i = 0; i < std::min(kMaxActors, result.actors.size()); ++i) {
        const std::optional<ReportFigure> figure = draw_actor(renderer, run, config, result.actors[i]);
        if (!figure) continue;
        std::vector<Image> images;
        for (const auto& [caption, image] : figure->images) images.push_back(image);
        std::string name = result.actors[i].track;
        // File names cannot contain a slash.
        std::ranges::replace(name, '/', '-');
        write_png(folder / fmt::format("actor_{}.png", name), stack_images(images));
    }
}

}  // namespace relidar::cli
