// SPDX-License-Identifier: Apache-2.0
#include "diff/backward/pose_gradients.hpp"

#include <algorithm>

#include "base/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

// Number of surfels per workgroup. The first kernel sums the gradients of each workgroup,
// the second kernel sums over the workgroups.
constexpr std::uint32_t kSurfelsPerBlock = 1024;
constexpr std::size_t kRecordFloats = 16;  // of the values that kernels read for a surfel

struct BlockTable {
    std::vector<shared::PoseBlock> blocks;
    std::vector<std::uint32_t> first;  ///< [instances + 1] first block of each instance
};

/// Splits the surfels of each instance into blocks for the sums of gradients. Instances
/// of a model share its surfels, but not their rows of gradients, so a block has two
/// start indices. Only the first instance of a model has the gradient of the view
/// direction, because the direction belongs to the model's surfels.
BlockTable split_into_blocks(const DeviceScene& scene) {
    const Scene& layout = scene.layout();
    BlockTable table;
    std::vector<bool> has_earlier_instance(layout.models.size(), false);
    for (std::size_t instance = 0; instance < layout.instances.size(); ++instance) {
        const std::uint32_t model_index = layout.instances[instance].model;
        const SurfelModel& model = layout.models[model_index];
        const std::uint32_t first_row = scene.first_gradient_row(instance);
        const bool is_first_instance = !has_earlier_instance[model_index];
        has_earlier_instance[model_index] = true;
        table.first.push_back(std::uint32_t(table.blocks.size()));
        for (std::uint32_t offset = 0; offset < model.count; offset += kSurfelsPerBlock) {
            const std::uint32_t n_surfels = std::min(kSurfelsPerBlock, model.count - offset);
            table.blocks.push_back({.first_surfel = model.first + offset,
                                    .first_row = first_row + offset,
                                    .n_surfels = n_surfels,
                                    .with_view = is_first_instance ? 1u : 0u});
        }
    }
    table.first.push_back(std::uint32_t(table.blocks.size()));  // end of the last instance
    return table;
}

}  // namespace

DeviceGradients::PoseGradientSums::PoseGradientSums(Device& device, const DeviceScene& scene) {
    const BlockTable table = split_into_blocks(scene);
    blocks = Array<shared::PoseBlock>(device, table.blocks, "pose blocks");
    first_block = Array<std::uint32_t>(device, table.first, "first pose blocks");
    sums = {device, RELIDAR_POSE_SUMS * table.blocks.size(), "pose sums"};
    d_view = {device, 3 * std::size_t(scene.size()), "view gradient"};
}

/// Creates the kernels that sum gradients over blocks, instances and the scene.
PoseGradientKernels::PoseGradientKernels(Device& device)
    : blocks_(device, "diff/backward/pose_blocks", {kWorkgroup}),
      poses_(device, "diff/backward/poses", {kWorkgroup}),
      sensor_(device, "diff/backward/sensor_pose") {}

void PoseGradientKernels::reduce(Stream& stream, const DeviceScene& scene, const ImageModel& model,
                                 const glm::vec3& view_origin_m, DeviceGradients& gradients) {
    const DeviceGradients::PoseGradientSums& sums = *gradients.pose_sums;
    const auto n_instances = std::uint32_t(scene.layout().instances.size());
    const auto n_blocks = std::uint32_t(sums.blocks.size());
    RELIDAR_ASSERT_LE(std::size_t(n_instances) + 1, sums.first_block.size());
    // A workgroup sums the gradients of a block (up to 1024 surfels of an instance).
    relidar::run(stream, blocks_, kThreads * std::size_t(n_blocks),
                 {.records = scene.surfel_records().address(),
                  .d_records = gradients.records.address(),
                  .d_view = sums.d_view.address(),
                  .blocks = sums.blocks.address(),
                  .sums = sums.sums.address(),
                  .n_blocks = n_blocks,
                  .sh_per_surfel = model.sh_direction == ShDirection::surfel ? 1u : 0u});
    // Sums the blocks of each instance: first_block[i] to first_block[i + 1] - 1.
    relidar::run(stream, poses_, kThreads * std::size_t(n_instances),
                 {.instances = scene.instance_table().address(),
                  .sums = sums.sums.address(),
                  .first_block = sums.first_block.address(),
                  .d_poses = gradients.poses.address(),
                  .view_origin = view_origin_m,
                  .n_instances = n_instances});
    // A motion of the sensor moves all instances the opposite way.
    relidar::run(stream, sensor_, 1,
                 {.instances = scene.instance_table().address(),
                  .d_poses = gradients.poses.address(),
                  .d_sensor = gradients.sensor.address(),
                  .view_origin = view_origin_m,
                  .n_instances = n_instances});
}

DeviceGradients::DeviceGradients(Device& device, const DeviceScene& scene, const GradientSelection& selection,
                                 std::uint32_t n_rays)
    : surfels(device, scene.size(), "gradient", scene.surfel_parameters().parameters_used()),
      records(device, kRecordFloats * scene.count_rows(), "record gradient"),
      touched(device, scene.size(), "flags of surfels with a gradient") {
    constexpr std::size_t kRayFloats = 6;   // dL/d(origin, direction)
    constexpr std::size_t kPoseFloats = 6;  // dL/d(translation, rotation)
    if (selection.rays) rays = {device, kRayFloats * n_rays, "ray gradient"};
    if (!selection.poses) return;
    poses = {device, kPoseFloats * scene.layout().instances.size(), "pose gradient"};
    sensor = {device, kPoseFloats, "sensor pose gradient"};
    pose_sums = std::make_unique<PoseGradientSums>(device, scene);
}

DeviceGradients::~DeviceGradients() = default;
DeviceGradients::DeviceGradients(DeviceGradients&&) noexcept = default;
DeviceGradients& DeviceGradients::operator=(DeviceGradients&&) noexcept = default;

}  // namespace relidar
