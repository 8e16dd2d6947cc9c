// SPDX-License-Identifier: Apache-2.0
// Computes errors for regions that users examine: moving boxes, all other pixels, and
// bands of range. Compares every pixel that has a real return, even if the rendered pixel
// counts as dropped. Otherwise more drops would improve the score of a region. The
// fraction of rendered returns is a separate metric.
#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

#include <algorithm>
#include <cmath>

#include <relidar/log/log.hpp>
#include "base/fail.hpp"
#include "score/metrics/image_errors.hpp"

namespace relidar {
namespace {

using namespace metrics;

constexpr float kEdgeJump_m = 0.5f, kEdgeJumpShare = 0.05f;  // share of the range of the pixel
constexpr double kLargeError_m = 1.0;

PixelRegion range_band(const RangeImage& real_image, double min_range_m, double max_range_m) {
    PixelRegion region{fmt::format("range_{:.0f}_{:.0f}_m", min_range_m, max_range_m),
                       PixelMask(real_image.range_m.size())};
    for (std::size_t i = 0; i < region.pixels.size(); ++i)
        region.pixels[i] =
            double(real_image.range_m[i]) > min_range_m && double(real_image.range_m[i]) <= max_range_m;
    return region;
}

/// Returns a mask of the rays of a frame whose return is in a moving box.
/// @param offset  pose of the sensor that made the scan, in the frame of the log's sensor
PixelMask mask_boxes(std::vector<BoxTrack> boxes, const Log& log, const Frame& frame, const Pose& offset) {
    const PoseTrack track = mount_track(log.lidar_track(frame.lidar), offset);
    // Evaluates is_moving() only once for each box, because it is slow.
    std::erase_if(boxes, [](const BoxTrack& box) { return !box.is_moving(); });
    PixelMask moving(frame.scan.range_m.size());
    for (std::size_t ray = 0; ray < moving.size(); ++ray) {
        if (!(frame.scan.range_m[ray] > 0.0f)) continue;
        const WorldRay world_ray =
            make_world_ray(track, frame.time_s, frame.scan.rays, ray, log.rolling_shutter);
        const glm::dvec3 point_m = world_ray.origin_m + double(frame.scan.range_m[ray]) * world_ray.direction;
        const double offset_s = log.rolling_shutter ? double(frame.scan.rays.time_offset_s[ray]) : 0.0;
        moving[ray] = is_in_moving_box(boxes, point_m, frame.time_s + offset_s, 0.0);
    }
    return moving;
}

std::ptrdiff_t count_pixels(const PixelMask& mask) { return std::ranges::count(mask, true); }

/// Returns how many pixels of a mask have a range error above 1 m.
std::size_t count_large_errors(const RangeImage& rendered, const RangeImage& real, const PixelMask& mask) {
    std::size_t n_large = 0;
    for (std::size_t i = 0; i < mask.size(); ++i) {
        const double error_m = std::abs(double(rendered.range_m[i]) - double(real.range_m[i]));
        if (mask[i] && error_m > kLargeError_m) ++n_large;
    }
    return n_large;
}

/// Adds the scores of one region.
/// @param rendered_returns,real_returns  returns of the full images
void add_region_scores(MetricValues& row, const PixelRegion& region, const RangeImage& rendered,
                       const PixelMask& rendered_returns, const RangeImage& real,
                       const PixelMask& real_returns, const MetricOptions& options) {
    const std::string name = region.name + "/";
    // Values are compared at all real returns, also if the rendering drops them.
    const PixelMask compared = intersect_masks(region.pixels, real_returns);
    const auto n_compared = count_pixels(compared);
    row[name + "pixels"] = double(n_compared);
    if (n_compared == 0) return;
    row[name + "share"] = double(n_compared) / double(count_pixels(real_returns));
    add_masked_errors(row, name + "depth_", "_m", rendered.range_m, real.range_m, compared,
                      options.max_range_m);
    add_masked_errors(row, name + "intensity_", "", rendered.intensity, real.intensity, compared,
                      kMaxIntensity);

    const PixelMask returned_both = intersect_masks(compared, rendered_returns);
    const auto n_both = count_pixels(returned_both);
    row[name + "returned"] = double(n_both) / double(n_compared);
    if (n_both > 0)
        row[name + "above_1m"] = double(count_large_errors(rendered, real, returned_both)) / double(n_both);
    if (region.scores_clouds)
        add_cloud_metrics(row, name, rendered, intersect_masks(region.pixels, rendered_returns), real,
                          compared);
}

}  // namespace

MetricValues evaluate_regions(const RangeImage& rendered, const RangeImage& real,
                              const std::vector<PixelRegion>& regions, const MetricOptions& options) {
    check_comparable(rendered, real);
    const PixelMask real_returns = return_mask(real, kRealDropThreshold),
                    rendered_returns = return_mask(rendered, options.strict_drop_threshold);
    MetricValues row;
    for (const PixelRegion& region : regions) {
        if (region.pixels.size() != real_returns.size())
            fail("cannot compute scores of region {}: its mask has {} pixels, expected {}", region.name,
                 region.pixels.size(), real_returns.size());
        add_region_scores(row, region, rendered, rendered_returns, real, real_returns, options);
    }
    return row;
}

std::vector<bool> mask_edges(const RangeImage& real) {
    const bool circular = is_full_turn(real.rows, real.columns, real.direction);
    PixelMask edges(real.range_m.size());
    // Marks two neighbouring pixels if the range jumps between them.
    const auto compare_pixels = [&](std::size_t a, std::size_t b) {
        const float a_m = real.range_m[a], b_m = real.range_m[b], jump_m = std::abs(a_m - b_m);
        const bool have_returns = a_m > 0.0f && b_m > 0.0f;
        if (!have_returns || !(jump_m > kEdgeJump_m)) return;
        if (jump_m > kEdgeJumpShare * a_m) edges[a] = true;
        if (jump_m > kEdgeJumpShare * b_m) edges[b] = true;
    };
    const auto n_columns = std::size_t(real.columns);
    for (std::size_t i = 0; i < edges.size(); ++i) {
        const bool is_last_column = (i + 1) % n_columns == 0;
        if (i + n_columns < edges.size()) compare_pixels(i, i + n_columns);
        if (!is_last_column) compare_pixels(i, i + 1);
        else if (circular) compare_pixels(i, i + 1 - n_columns);
    }
    return edges;
}

std::vector<PixelRegion> make_regions(const RangeImage& real, const std::vector<bool>& moving_pixels) {
    PixelMask resting = moving_pixels;
    resting.flip();
    std::vector<PixelRegion> regions{{"all", PixelMask(moving_pixels.size(), true)},
                                     {"moving_boxes", moving_pixels},
                                     {"static", resting},
                                     // bands of the measured range in metres
                                     range_band(real, 0.0, 20.0),
                                     range_band(real, 20.0, 40.0),
                                     range_band(real, 40.0, 80.0)};
    if (real.rows > 1) {
        PixelMask edges = mask_edges(real), smooth = edges;
        smooth.flip();
        regions.push_back({.name = "edges", .pixels = std::move(edges), .scores_clouds = true});
        regions.push_back({.name = "smooth", .pixels = std::move(smooth), .scores_clouds = true});
    }
    return regions;
}

std::vector<bool> mask_labelled_movers(const Log& log, const Frame& frame, const Pose& sensor_offset) {
    std::vector<BoxTrack> labelled;
    // discover_tracks() may have added poses before the first or after the last label of
    // a box. Removes these poses, so that the result does not depend on them.
    for (const BoxTrack& box : log.boxes)
        if (box.category != kDiscoveredCategory) labelled.push_back(box.labelled_part());
    return mask_boxes(std::move(labelled), log, frame, sensor_offset);
}

std::vector<bool> mask_found_movers(const Log& log, const Frame& frame, const Pose& sensor_offset) {
    std::vector<BoxTrack> discovered = log.boxes;
    std::erase_if(discovered, [](const BoxTrack& box) { return box.category != kDiscoveredCategory; });
    return mask_boxes(std::move(discovered), log, frame, sensor_offset);
}

}  // namespace relidar
