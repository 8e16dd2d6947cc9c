// SPDX-License-Identifier: Apache-2.0
#include "train/poses/moved_rays.hpp"

#include <algorithm>

#include "base/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

std::uint32_t max_frame_poses(const std::vector<TrainingFrameData>& frames) {
    std::uint32_t most = 0;
    for (const TrainingFrameData& frame : frames) most = std::max(most, frame.n_knots);
    return most;
}

}  // namespace

PoseCorrectedRays::PoseCorrectedRays(Device& device, const std::vector<TrainingFrameData>& frames)
    : most_knots_(max_frame_poses(frames)),
      moved_(device, max_frame_rays(frames), "moved rays"),
      knots_(device, most_knots_, "sensor poses"),
      rows_(device, std::size_t(kGroupsPerPose) * 6 * most_knots_, "pose gradients"),
      move_(device, "train/move_rays"),
      gradients_(device, "train/knot_gradients",
                 {{SpecialisationConstantId::WORKGROUP_SIZE, RELIDAR_KNOT_WORKGROUP}}) {}

void PoseCorrectedRays::move_rays(Stream& stream, const TrackCorrection& correction,
                                  TrainingFrameData& frame) {
    std::vector<shared::PoseKnot> knots;
    for (std::size_t k = frame.first_knot; k < frame.first_knot + frame.n_knots; ++k) {
        const Twist c = correction.correction_at(k);
        knots.push_back({glm::vec3(correction.uncorrected_track().pose[k].translation),
                         glm::vec3(c[0], c[1], c[2]), glm::vec3(c[3], c[4], c[5])});
    }
    stream.impl().record_write(knots_.buffer(), knots.data(), knots.size() * sizeof(knots[0]));
    run(stream, move_, frame.n_rays,
        {.rays = frame.arrays->rays.address(),
         .interpolations = frame.arrays->track_positions.address(),
         .knots = knots_.address(),
         .moved = moved_.address(),
         .n_rays = frame.n_rays});
    frame.moved_rays = &moved_;
}

/// Records GPU commands that sum the gradients of the rays for each pose. Each of the
/// workgroups of a pose writes one row of partial sums.
void PoseCorrectedRays::record_sums(Stream& stream, const TrainingFrameData& frame, const SampledBatch& batch,
                                    const Array<float, shared::DeviceRayGradients>& ray_gradients) {
    RELIDAR_ASSERT_LE(std::size_t(6) * batch.rays.n_rays, ray_gradients.size());
    run(stream, gradients_, std::size_t(RELIDAR_KNOT_WORKGROUP) * kGroupsPerPose * most_knots_,
        {.moved = batch.rays.rays->address(),
         .interpolations = frame.arrays->track_positions.address(),
         .knots = knots_.address(),
         .d_rays = ray_gradients.address(),
         .rows = rows_.address(),
         .n_rays = batch.rays.n_rays,
         .first_ray = batch.rays.first,
         .ray_stride = batch.rays.stride,
         .columns = batch.window.columns,
         .first_column = batch.window.first,
         .column_stride = batch.window.stride,
         .n_columns = batch.window.n_columns,
         .n_knots = most_knots_,
         .n_rows = kGroupsPerPose});
}

/// Adds the rows of partial sums on the host, which gives one gradient per pose.
std::vector<PoseGradient> PoseCorrectedRays::sum_gradients(std::span<const float> sums,
                                                           const TrainingFrameData& frame) const {
    std::vector<PoseGradient> result(frame.n_knots);
    for (std::size_t k = 0; k < result.size(); ++k) {
        result[k].pose = frame.first_knot + k;
        for (std::size_t row = 0; row < kGroupsPerPose; ++row)
            for (std::size_t j = 0; j < 6; ++j)
                result[k].gradient[j] += sums[6 * (row * most_knots_ + k) + j];
    }
    return result;
}

}  // namespace relidar
