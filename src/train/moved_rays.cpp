// SPDX-License-Identifier: Apache-2.0
// Binding of train/move_rays and train/knot_gradients.
#include "train/moved_rays.hpp"

#include <algorithm>

#include "core/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

/// Where each ray of a frame was fired in the track of the sensor; `first` becomes the first pose that takes part, `n` how many do.
std::vector<shared::RayPlace> places_of(const Sequence& sequence, const Frame& frame, std::size_t& first, std::uint32_t& n) {
    std::vector<TrackPlace> places;
    for (const float offset_s : frame.scan.rays.time_offset_s)
        places.push_back(sequence.world_from_vehicle.place(frame.time_s + (sequence.rolling_shutter ? double(offset_s) : 0.0)));
    const auto [low, high] =
        std::minmax_element(places.begin(), places.end(), [](const TrackPlace& a, const TrackPlace& b) { return a.left < b.left; });
    first = low->left;
    n = static_cast<std::uint32_t>(std::min(high->left + 2, sequence.world_from_vehicle.pose.size()) - first);
    std::vector<shared::RayPlace> result;
    for (const TrackPlace& p : places) result.push_back({static_cast<std::uint32_t>(p.left - first), static_cast<float>(p.s)});
    return result;
}

}  // namespace

std::vector<MovedRays::Source> MovedRays::make_sources(Device& device, const Sequence& sequence, std::vector<FrameData>& frames) {
    std::vector<Source> sources;
    for (FrameData& frame : frames) {
        Source& source = sources.emplace_back();
        const std::vector<shared::RayPlace> places =
            places_of(sequence, sequence.frames[std::size_t(frame.position)], source.first_knot, source.n_knots);
        source.places = Array<shared::RayPlace>(device, std::span<const shared::RayPlace>(places), "places of rays");
        source.rays = std::move(frame.rays);
        frame.rays = Array<DeviceRay>(device, frame.n_rays, "moved rays");
    }
    return sources;
}

MovedRays::MovedRays(Device& device, const Sequence& sequence, std::vector<FrameData>& frames)
    : sources_(make_sources(device, sequence, frames)),
      most_knots_(std::max_element(sources_.begin(), sources_.end(), [](const Source& a, const Source& b) { return a.n_knots < b.n_knots; })
                      ->n_knots),
      knots_(device, most_knots_, "sensor poses"),
      rows_(device, std::size_t(kRows) * 6 * most_knots_, "pose gradients"),
      move_(device, "train/move_rays"),
      gradients_(device, "train/knot_gradients", {{ConstantId::WORKGROUP_SIZE, RELIDAR_KNOT_WORKGROUP}}) {}

void MovedRays::move(Stream& stream, const TrackCorrection& sensor, std::size_t frame_index, FrameData& frame) {
    const Source& source = sources_[frame_index];
    std::vector<shared::PoseKnot> knots;
    for (std::size_t k = source.first_knot; k < source.first_knot + source.n_knots; ++k) {
        const Twist c = sensor.at(k);
        knots.push_back({glm::vec3(sensor.uncorrected().pose[k].translation), glm::vec3(c[0], c[1], c[2]), glm::vec3(c[3], c[4], c[5])});
    }
    impl_of(stream).write(knots_.buffer(), knots.data(), knots.size() * sizeof(knots[0]));
    run(stream, move_, frame.n_rays,
        {.rays = source.rays.address(),
         .places = source.places.address(),
         .knots = knots_.address(),
         .moved = frame.rays.address(),
         .n_rays = frame.n_rays});
}

void MovedRays::sum_gradients(Stream& stream, std::size_t frame_index, const SampledBatch& batch, const Array<float>& d_rays) {
    RELIDAR_ASSERT_LE(std::size_t(6) * batch.rays.n_rays, d_rays.size());
    run(stream, gradients_, std::size_t(RELIDAR_KNOT_WORKGROUP) * kRows * most_knots_,
        {.moved = batch.rays.rays->address(),
         .places = sources_[frame_index].places.address(),
         .knots = knots_.address(),
         .d_rays = d_rays.address(),
         .rows = rows_.address(),
         .n_rays = batch.rays.n_rays,
         .first_ray = batch.rays.first,
         .ray_stride = batch.rays.stride,
         .columns = batch.window.columns,
         .first_column = batch.window.first,
         .column_stride = batch.window.stride,
         .n_columns = batch.window.n_columns,
         .n_knots = most_knots_,
         .n_rows = kRows});
}

std::vector<PoseGradient> MovedRays::gradients_in(std::span<const float> gradient_rows, std::size_t frame_index) const {
    const Source& source = sources_[frame_index];
    std::vector<PoseGradient> result(source.n_knots);
    for (std::size_t k = 0; k < result.size(); ++k) {
        result[k].pose = source.first_knot + k;
        for (std::size_t row = 0; row < kRows; ++row)
            for (std::size_t j = 0; j < 6; ++j) result[k].gradient[j] += gradient_rows[6 * (row * most_knots_ + k) + j];
    }
    return result;
}

}  // namespace relidar
