// SPDX-License-Identifier: Apache-2.0
// Runs two kernels: train/move_rays moves rays to corrected poses, and
// train/knot_gradients computes the gradients of these poses.
#include "train/poses/moved_rays.hpp"

#include <algorithm>

#include "base/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

std::uint32_t count_max_pose_knots(const std::vector<FrameData>& frames) {
    std::uint32_t most = 0;
    for (const FrameData& frame : frames) most = std::max(most, frame.n_knots);
    return most;
}

}  // namespace

MovedRays::MovedRays(Device& device, const std::vector<FrameData>& frames)
    : most_knots_(count_max_pose_knots(frames)),
      moved_(device, find_max_rays(frames), "moved rays"),
      knots_(device, most_knots_, "sensor poses"),
      rows_(device, std::size_t(kRows) * 6 * most_knots_, "pose gradients"),
      move_(device, "train/move_rays"),
      gradients_(device, "train/knot_gradients", {{ConstantId::WORKGROUP_SIZE, RELIDAR_KNOT_WORKGROUP}}) {}

void MovedRays::move(Stream& stream, const TrackCorrection& sensor, FrameData& frame) {
    std::vector<shared::PoseKnot> knots;
    for (std::size_t k = frame.first_knot; k < frame.first_knot + frame.n_knots; ++k) {
        const Twist c = sensor.at(k);
        knots.push_back({glm::vec3(sensor.get_uncorrected_track().pose[k].translation),
                         glm::vec3(c[0], c[1], c[2]), glm::vec3(c[3], c[4], c[5])});
    }
    stream.impl().write(knots_.buffer(), knots.data(), knots.size() * sizeof(knots[0]));
    run(stream, move_, frame.n_rays,
        {.rays = frame.arrays->rays.address(),
         .places = frame.arrays->places.address(),
         .knots = knots_.address(),
         .moved = moved_.address(),
         .n_rays = frame.n_rays});
    frame.moved_rays = &moved_;
}

void MovedRays::sum_gradients(Stream& stream, const FrameData& frame, const SampledBatch& batch,
                              const Array<float, shared::DeviceRayGradients>& d_rays) {
    RELIDAR_ASSERT_LE(std::size_t(6) * batch.rays.n_rays, d_rays.size());
    run(stream, gradients_, std::size_t(RELIDAR_KNOT_WORKGROUP) * kRows * most_knots_,
        {.moved = batch.rays.rays->address(),
         .places = frame.arrays->places.address(),
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

std::vector<PoseGradient> MovedRays::sum_pose_gradients(std::span<const float> gradient_rows,
                                                        const FrameData& frame) const {
    std::vector<PoseGradient> result(frame.n_knots);
    for (std::size_t k = 0; k < result.size(); ++k) {
        result[k].pose = frame.first_knot + k;
        for (std::size_t row = 0; row < kRows; ++row)
            for (std::size_t j = 0; j < 6; ++j)
                result[k].gradient[j] += gradient_rows[6 * (row * most_knots_ + k) + j];
    }
    return result;
}

}  // namespace relidar
