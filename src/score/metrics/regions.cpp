// SPDX-License-Identifier: Apache-2.0
// Computes errors for regions that users examine: moving boxes, all other pixels, and
// bands of range. Compares every pixel with a real return, even if the rendered pixel
// counts as dropped. Otherwise more drops would improve the score of a region. The
// fraction of rendered returns is a separate metric.
#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sequence.hpp>
#include "pixel_errors.hpp"

namespace relidar {
namespace {

using namespace metrics_detail;

constexpr double kBoxMargin_m = 0.0;

Mask combine_masks(const Mask& first, const Mask& second) {
    Mask mask(first.size());
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = first[i] && second[i];
    return mask;
}

Region make_range_band(const RangeImage& real, double low_m, double high_m) {
    Region region{fmt::format("range_{:.0f}_{:.0f}_m", low_m, high_m), Mask(real.range_m.size())};
    for (std::size_t i = 0; i < region.pixels.size(); ++i)
        region.pixels[i] = double(real.range_m[i]) > low_m && double(real.range_m[i]) <= high_m;
    return region;
}

/// Returns a mask of the returns of a frame that are in a moving box.
Mask find_returns_in_moving_boxes(std::vector<BoxTrack> boxes, const Sequence& sequence, const Frame& frame,
                                  const Pose& sensor_offset) {
    const PoseTrack track = mount_on_track(sequence.world_from_sensor(frame.lidar), sensor_offset);
    // is_moving() is expensive, so it is evaluated only once for each box.
    std::erase_if(boxes, [](const BoxTrack& box) { return !box.is_moving(); });
    Mask moving(frame.scan.range_m.size());
    for (std::size_t ray = 0; ray < moving.size(); ++ray) {
        if (!(frame.scan.range_m[ray] > 0.0f)) continue;
        const WorldRay w =
            make_world_ray(track, frame.time_s, frame.scan.rays, ray, sequence.rolling_shutter);
        const double t_s =
            frame.time_s + (sequence.rolling_shutter ? double(frame.scan.rays.time_offset_s[ray]) : 0.0);
        moving[ray] = is_in_moving_box(boxes, w.origin_m + double(frame.scan.range_m[ray]) * w.direction, t_s,
                                       kBoxMargin_m);
    }
    return moving;
}

}  // namespace

MetricRow evaluate_regions(const RangeImage& rendered, const RangeImage& real,
                           const std::vector<Region>& regions, const MetricOptions& options) {
    check_pair(rendered, real);
    const Mask truth = make_positive_range_mask(real, kRealDropThreshold),
               kept = make_positive_range_mask(rendered, options.strict_drop_threshold);
    MetricRow row;
    for (const Region& region : regions) {
        if (region.pixels.size() != truth.size())
            throw DataError(
                fmt::format("cannot compute scores of region {}: its mask has {} pixels, expected {}",
                            region.name, region.pixels.size(), truth.size()));
        const Mask mask = combine_masks(region.pixels, truth);
        const auto n = std::count(mask.begin(), mask.end(), true);
        const std::string name = region.name + "/";
        row[name + "pixels"] = double(n);
        if (n == 0) continue;
        const Mask returned_both = combine_masks(mask, kept);
        row[name + "returned"] =
            double(std::count(returned_both.begin(), returned_both.end(), true)) / double(n);
        add_errors(row, name + "depth_", "_m", select_values(rendered.range_m, mask, options.max_range_m),
                   select_values(real.range_m, mask, options.max_range_m));
        add_errors(row, name + "intensity_", "", select_values(rendered.intensity, mask, kMaxIntensity),
                   select_values(real.intensity, mask, kMaxIntensity));
    }
    return row;
}

std::vector<Region> make_standard_regions(const RangeImage& real, const std::vector<bool>& moving) {
    Mask resting = moving;
    resting.flip();
    return {{"all", Mask(moving.size(), true)},
            {"moving_boxes", moving},
            {"static", resting},
            make_range_band(real, 0.0, 20.0),
            make_range_band(real, 20.0, 40.0),
            make_range_band(real, 40.0, 80.0)};
}

std::vector<bool> find_moving_returns(const Sequence& sequence, const Frame& frame,
                                      const Pose& sensor_offset) {
    std::vector<BoxTrack> labelled = sequence.boxes;
    std::erase_if(labelled, [](const BoxTrack& box) { return box.category == kDiscoveredCategory; });
    // Uses only the labelled poses of each box, without poses that discover_tracks()
    // added. Thus runs with and without added poses are compared on the same returns.
    for (BoxTrack& box : labelled) box = box.get_labelled_part();
    return find_returns_in_moving_boxes(std::move(labelled), sequence, frame, sensor_offset);
}

std::vector<bool> find_discovered_returns(const Sequence& sequence, const Frame& frame,
                                          const Pose& sensor_offset) {
    std::vector<BoxTrack> discovered = sequence.boxes;
    std::erase_if(discovered, [](const BoxTrack& box) { return box.category != kDiscoveredCategory; });
    return find_returns_in_moving_boxes(std::move(discovered), sequence, frame, sensor_offset);
}

}  // namespace relidar
