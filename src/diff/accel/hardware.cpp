// SPDX-License-Identifier: Apache-2.0
#include "diff/accel/hardware.hpp"

#include <algorithm>
#include <utility>

#include "diff/shared/accel.h"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

using enum SpecialisationConstantId;

struct VulkanAccelStructure {
    Device::Impl* device = nullptr;
    std::unique_ptr<Buffer> storage;
    VkAccelerationStructureKHR handle = VK_NULL_HANDLE;
    std::uint64_t address = 0;

    VulkanAccelStructure(Device& d, VkAccelerationStructureTypeKHR type, VkDeviceSize n, std::string text) {
        device = &d.impl();
        storage = std::make_unique<Buffer>(d, n, text);
        if (device->compile_only) return;
        VkAccelerationStructureCreateInfoKHR info{VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_CREATE_INFO_KHR};
        info.buffer = storage->impl().handle;
        info.size = n;
        info.type = type;
        gpu::vk_check(vkCreateAccelerationStructureKHR(device->device, &info, nullptr, &handle),
                      "vkCreateAccelerationStructureKHR");
        gpu::set_object_name(device->device, VK_OBJECT_TYPE_ACCELERATION_STRUCTURE_KHR, handle, text);
        VkAccelerationStructureDeviceAddressInfoKHR query{
            VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_DEVICE_ADDRESS_INFO_KHR};
        query.accelerationStructure = handle;
        address = vkGetAccelerationStructureDeviceAddressKHR(device->device, &query);
    }
    ~VulkanAccelStructure() {
        if (handle && !device->is_forked())
            vkDestroyAccelerationStructureKHR(device->device, handle, nullptr);
    }
    VulkanAccelStructure(const VulkanAccelStructure&) = delete;
    VulkanAccelStructure& operator=(const VulkanAccelStructure&) = delete;
};

/// Input for building one acceleration structure. Its three Vulkan structs are stored
/// together, because they contain pointers to each other.
struct BuildInput {
    VkAccelerationStructureGeometryKHR geometry{VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_KHR};
    VkAccelerationStructureBuildGeometryInfoKHR info{
        VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_BUILD_GEOMETRY_INFO_KHR};
    VkAccelerationStructureBuildRangeInfoKHR range{};

    /// Returns the memory sizes that the build needs.
    /// @param n_primitives number of triangles, boxes or instances
    VkAccelerationStructureBuildSizesInfoKHR query_sizes(Device::Impl& device, std::uint32_t n_primitives) {
        range.primitiveCount = n_primitives;
        // set_target() may have set a structure that was destroyed since then.
        info.srcAccelerationStructure = info.dstAccelerationStructure = VK_NULL_HANDLE;
        info.geometryCount = 1;
        info.pGeometries = &geometry;
        VkAccelerationStructureBuildSizesInfoKHR result{
            VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_BUILD_SIZES_INFO_KHR};
        vkGetAccelerationStructureBuildSizesKHR(
            device.device, VK_ACCELERATION_STRUCTURE_BUILD_TYPE_DEVICE_KHR, &info, &n_primitives, &result);
        return result;
    }

    /// Selects the structure to build. With `update`, the driver refits the existing
    /// structure instead, which is faster but keeps its tree.
    void set_target(const VulkanAccelStructure& target, bool update, std::uint64_t scratch_address) {
        info.mode = update ? VK_BUILD_ACCELERATION_STRUCTURE_MODE_UPDATE_KHR
                           : VK_BUILD_ACCELERATION_STRUCTURE_MODE_BUILD_KHR;
        info.srcAccelerationStructure = update ? target.handle : VK_NULL_HANDLE;
        info.dstAccelerationStructure = target.handle;
        info.scratchData.deviceAddress = scratch_address;
    }
};

/// Records a single command for all builds, so that the device can run them concurrently.
/// The command gets a copy of the inputs.
void record_builds(Stream::Impl& stream, const std::string& command_name, std::vector<BuildInput> inputs) {
    stream.record_command(command_name, [inputs = std::move(inputs)](VkCommandBuffer commands) {
        std::vector<VkAccelerationStructureBuildGeometryInfoKHR> infos;
        std::vector<const VkAccelerationStructureBuildRangeInfoKHR*> ranges;
        for (const BuildInput& input : inputs) {
            infos.push_back(input.info);
            infos.back().pGeometries = &input.geometry;
            ranges.push_back(&input.range);
        }
        vkCmdBuildAccelerationStructuresKHR(commands, std::uint32_t(infos.size()), infos.data(),
                                            ranges.data());
    });
}

/// Triangle mesh around one surfel or 3D Gaussian. Kernel diff/accel/proxies writes its
/// corners.
struct ProxyTriangleMesh {
    std::uint32_t n_corners;
    std::vector<std::uint32_t> corners;  ///< [triangles,3] indices of the corners
};

const ProxyTriangleMesh kRectangleMesh{4, {0, 1, 2, 2, 3, 0}};
const ProxyTriangleMesh kIcosahedronMesh{
    12, {0, 1, 8, 0, 1, 10, 0, 4, 5,  0, 4, 8, 0, 5, 10, 1, 6, 7,  1, 6, 8, 1, 7,  10, 2, 3, 9, 2, 3,  11,
         2, 4, 5, 2, 4, 9,  2, 5, 11, 3, 6, 7, 3, 6, 9,  3, 7, 11, 4, 8, 9, 5, 10, 11, 6, 8, 9, 7, 10, 11}};

}  // namespace

struct RayQueryAccel::Impl {
    Device& device;
    ProxyShape proxy;
    PrimitiveType primitive;
    const ProxyTriangleMesh& mesh =
        properties_of(primitive).mesh == ProxyMesh::icosahedron ? kIcosahedronMesh : kRectangleMesh;
    Kernel<shared::ProxyParams> proxies{
        device,
        "diff/accel/proxies",
        {{BOXES, proxy == ProxyShape::boxes ? 1u : 0u}, {PRIMITIVE, std::uint32_t(primitive)}}};
    Array<float> geometry;  ///< vertices [n,corners,3] or boxes [n,6]
    /// [1] metres, stored as the bits of a float: maximum distance between a hit on a 3D
    /// Gaussian and a corner of the enclosing icosahedron. A ray query may find only the
    /// far side of the icosahedron, which is behind the hit. So it searches this far
    /// behind the farthest hit.
    Array<std::uint32_t> reach;
    /// Triangle indices for the largest model. Smaller models use the first indices, with
    /// an offset to their first vertex.
    Array<std::uint32_t> indices;
    /// one per model, null for a model without surfels
    std::vector<std::unique_ptr<VulkanAccelStructure>> blas;
    std::vector<BuildInput> blas_input;
    /// Offset of each model's scratch memory. Models need separate scratch memory,
    /// because they are built concurrently.
    std::vector<std::uint64_t> blas_scratch;
    std::unique_ptr<VulkanAccelStructure> tlas;
    BuildInput tlas_input;
    Kernel<shared::ModelRadiiParams> model_radii{
        device, "diff/accel/model_radii", {{PRIMITIVE, std::uint32_t(primitive)}}};
    /// [models] radius of a sphere around each model's origin. The sphere contains all
    /// hits of the model.
    Array<std::uint32_t, shared::ModelRadii> radii;
    Array<shared::MovingInstance> moving;  ///< [instances] instances that move during a sweep
    std::uint32_t n_moving = 0;
    Buffer scratch;
    std::uint64_t scratch_address = 0;
    VkDeviceSize scratch_bytes = 0;

    Impl(Device& d, const Scene& layout, ProxyShape shape, PrimitiveType type)
        : device(d),
          proxy(shape),
          primitive(type),
          radii(d, std::max<std::size_t>(layout.models.size(), 1), "radii of models"),
          moving(d, std::max<std::size_t>(layout.instances.size(), 1), "moving instances") {
        if (&mesh == &kIcosahedronMesh && proxy == ProxyShape::triangles)
            reach = {d, 1, "largest distance from a hit to a corner of the bounding icosahedron"};
    }

    std::size_t floats_per_surfel() const {
        return proxy == ProxyShape::boxes ? 6 : 3 * std::size_t(mesh.n_corners);
    }
    void set_geometry(BuildInput& input, const SurfelModel& model) const;
    void reserve_indices(std::uint32_t n_surfels);
    void allocate_blas(const SurfelModel& model);
    void allocate_tlas(std::size_t n_instances);
    void allocate_scratch();
    void compute_proxies(Stream& stream, const DeviceScene& scene, const AccelOptions& o, SurfelRange range) {
        // The kernel writes either vertices or boxes, so both use the same array.
        run(stream, proxies, range.count,
            {.records = scene.surfel_records().address(),
             .vertices = geometry.address_as<float, shared::ProxyVertices>(),
             .boxes = geometry.address_as<float, shared::SurfelBoxes>(),
             .reach = reach.address(),
             .alpha_min = scene.alpha_min(),
             .margin_m = o.margin_m,
             .margin_scale = o.margin_scale,
             .first_surfel = range.first,
             .n_surfels = range.count});
    }
    void compute_radii(Stream& stream, const DeviceScene& scene, const AccelOptions& o, SurfelRange range) {
        run(stream, model_radii, (range.count + RELIDAR_RADIUS_STRETCH - 1) / RELIDAR_RADIUS_STRETCH,
            {.records = scene.surfel_records().address(),
             .models = scene.model_table().address(),
             .radii = radii.address(),
             .alpha_min = scene.alpha_min(),
             .margin_m = o.margin_m,
             .margin_scale = o.margin_scale,
             .n_models = std::uint32_t(scene.layout().models.size()),
             .first_surfel = range.first,
             .n_surfels = range.count});
    }
    std::uint64_t write_instances(Stream::Impl& stream, const DeviceScene& scene);
};

/// Describes the geometry of one model, which is a part of the array `geometry`. The
/// geometry is not opaque, so that the shader can test every candidate hit.
void RayQueryAccel::Impl::set_geometry(BuildInput& input, const SurfelModel& model) const {
    if (proxy == ProxyShape::boxes) {
        input.geometry.geometryType = VK_GEOMETRY_TYPE_AABBS_KHR;
        input.geometry.geometry.aabbs = {VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_AABBS_DATA_KHR,
                                         nullptr,
                                         {geometry.buffer().impl().address + 24ull * model.first},
                                         24};
    } else {
        input.geometry.geometryType = VK_GEOMETRY_TYPE_TRIANGLES_KHR;
        auto& t = input.geometry.geometry.triangles;
        t = {};
        t.sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_TRIANGLES_DATA_KHR;
        t.vertexFormat = VK_FORMAT_R32G32B32_SFLOAT;
        t.vertexData.deviceAddress = geometry.buffer().impl().address + 12ull * mesh.n_corners * model.first;
        t.vertexStride = 12;
        t.maxVertex = mesh.n_corners * std::max(model.count, 1u) - 1;
        t.indexType = VK_INDEX_TYPE_UINT32;
        t.indexData.deviceAddress = indices.buffer().impl().address;
    }
    input.info.type = VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR;
    input.info.flags = VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR |
                       VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_UPDATE_BIT_KHR;
}

/// Writes the instances to temporary memory and returns their device address. Leaves out
/// absent instances and models without surfels.
std::uint64_t RayQueryAccel::Impl::write_instances(Stream::Impl& stream, const DeviceScene& scene) {
    const Scene& layout = scene.layout();
    std::vector<VkAccelerationStructureInstanceKHR> rows;
    std::vector<shared::MovingInstance> of_motion;
    for (std::size_t i = 0; i < layout.instances.size(); ++i) {
        const VulkanAccelStructure* model = blas[layout.instances[i].model].get();
        if (!model || !scene.poses()[i].present) continue;
        const glm::mat4 m(to_matrix(scene.poses()[i].world_from_model));
        VkAccelerationStructureInstanceKHR& row = rows.emplace_back();
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 4; ++c) row.transform.matrix[r][c] = m[c][r];
        row.instanceCustomIndex = std::uint32_t(i) & 0xffffffu;
        row.mask = RELIDAR_STANDING_MASK;
        if (!scene.poses()[i].motion.is_stationary()) {
            // A separate query tests each moving instance, so it gets one of the other
            // mask bits.
            row.mask = (RELIDAR_STANDING_MASK << (1 + of_motion.size() % RELIDAR_MOVING_MASKS)) & 0xffu;
            of_motion.push_back({std::uint32_t(i), layout.instances[i].model, row.mask});
        }
        row.instanceShaderBindingTableRecordOffset = 0;
        row.flags = VK_GEOMETRY_INSTANCE_TRIANGLE_FACING_CULL_DISABLE_BIT_KHR;
        row.accelerationStructureReference = model->address;
    }
    tlas_input.range.primitiveCount = std::uint32_t(rows.size());
    n_moving = std::uint32_t(of_motion.size());
    if (n_moving > 0)
        stream.record_write(moving.buffer(), of_motion.data(), of_motion.size() * sizeof(of_motion[0]));
    return rows.empty() ? 0 : stream.stage_bytes(rows.data(), rows.size() * sizeof(rows[0])).address;
}

/// Writes the triangles of the largest model, which all models use.
void RayQueryAccel::Impl::reserve_indices(std::uint32_t n_surfels) {
    if (proxy != ProxyShape::triangles || n_surfels * mesh.corners.size() <= indices.size()) return;
    // Each surfel has a copy of the mesh. The corners of a copy follow the corners of the
    // previous copy.
    std::vector<std::uint32_t> corners;
    corners.reserve(mesh.corners.size() * n_surfels);
    for (std::uint32_t i = 0; i < n_surfels; ++i)
        for (const std::uint32_t corner : mesh.corners) corners.push_back(mesh.n_corners * i + corner);
    indices = Array<std::uint32_t>(device, corners, "proxy indices");
}

/// Allocates the structure of a model, and a part of the scratch buffer for it.
void RayQueryAccel::Impl::allocate_blas(const SurfelModel& model) {
    BuildInput& input = blas_input.emplace_back();
    set_geometry(input, model);
    blas_scratch.push_back(scratch_bytes);
    blas.push_back(nullptr);
    const auto n_triangles = std::uint32_t(mesh.corners.size() / 3);
    const std::uint32_t n = model.count * (proxy == ProxyShape::boxes ? 1u : n_triangles);
    if (n == 0) return;
    const VkAccelerationStructureBuildSizesInfoKHR sizes = input.query_sizes(device.impl(), n);
    blas.back() = std::make_unique<VulkanAccelStructure>(
        device, VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR, sizes.accelerationStructureSize,
        "acceleration structure of " + model.name);
    const std::uint64_t alignment = device.impl().scratch_alignment;
    scratch_bytes +=
        (std::max(sizes.buildScratchSize, sizes.updateScratchSize) + alignment - 1) / alignment * alignment;
}

void RayQueryAccel::Impl::allocate_tlas(std::size_t n_instances) {
    const VkAccelerationStructureBuildSizesInfoKHR sizes =
        tlas_input.query_sizes(device.impl(), std::uint32_t(std::max<std::size_t>(n_instances, 1)));
    tlas = std::make_unique<VulkanAccelStructure>(device, VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR,
                                                  sizes.accelerationStructureSize, "top level");
    scratch_bytes = std::max(scratch_bytes, sizes.buildScratchSize);
}

void RayQueryAccel::Impl::allocate_scratch() {
    const std::uint64_t alignment = device.impl().scratch_alignment;
    if (scratch && scratch_bytes + alignment <= scratch.size_bytes()) return;
    scratch = Buffer(device, scratch_bytes + alignment, "acceleration structure scratch");
    scratch_address = (scratch.impl().address + alignment - 1) / alignment * alignment;
}

/// Allocates memory for the structures of all models and the top level. Does not build
/// them. All builds share one scratch buffer, in which each model has a separate part.
RayQueryAccel::RayQueryAccel(Device& device, const DeviceScene& scene, ProxyShape proxy) {
    impl_ = std::make_unique<Impl>(device, scene.layout(), proxy, scene.primitive());
    Impl& a = *impl_;
    const Scene& layout = scene.layout();
    std::uint32_t largest = 0;
    for (const SurfelModel& model : layout.models) largest = std::max(largest, model.count);
    a.geometry = Array<float>(device, scene.size() * a.floats_per_surfel(), "proxies");
    a.reserve_indices(largest);
    for (const SurfelModel& model : layout.models) a.allocate_blas(model);
    a.tlas_input.geometry.geometryType = VK_GEOMETRY_TYPE_INSTANCES_KHR;
    a.tlas_input.geometry.geometry.instances = {
        VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_INSTANCES_DATA_KHR, nullptr, VK_FALSE, {}};
    a.tlas_input.info.type = VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR;
    a.tlas_input.info.flags = VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR;
    a.allocate_tlas(layout.instances.size());
    a.allocate_scratch();
}

RayQueryAccel::~RayQueryAccel() = default;

void RayQueryAccel::record_build(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                                 const SurfelRanges& ranges, bool refit_only) {
    Impl& a = *impl_;
    std::uint32_t n = 0;
    for (const SurfelRange& range : ranges) n += range.count;
    // `reach` is a maximum over all 3D Gaussians: the distance between a hit and a corner
    // of the enclosing icosahedron. It is reset only if all models are updated, because
    // the other models would be missing from the new maximum.
    if (a.reach.size() && n == scene.size()) stream.fill(a.reach);
    for (const SurfelRange& range : ranges) a.compute_proxies(stream, scene, options, range);
    // The radii are maxima too.
    if (n == scene.size()) stream.fill(a.radii);
    for (const SurfelRange& range : ranges) a.compute_radii(stream, scene, options, range);
    std::vector<BuildInput> inputs;
    for (std::size_t i = 0; i < a.blas.size(); ++i) {
        const auto is_in = [&](const SurfelRange& range) {
            return range.contains_surfel(scene.layout().models[i].first);
        };
        if (!a.blas[i] || std::ranges::none_of(ranges, is_in)) continue;
        a.blas_input[i].set_target(*a.blas[i], refit_only, a.scratch_address + a.blas_scratch[i]);
        inputs.push_back(a.blas_input[i]);
    }
    if (!inputs.empty())
        record_builds(stream.impl(), refit_only ? "accel/refit" : "accel/build", std::move(inputs));
    rebuild_top_level(stream, scene);
}

void RayQueryAccel::rebuild_top_level(Stream& stream, const DeviceScene& scene) {
    Impl& a = *impl_;
    Stream::Impl& s = stream.impl();
    a.tlas_input.geometry.geometry.instances.data.deviceAddress = a.write_instances(s, scene);
    a.tlas_input.set_target(*a.tlas, false, a.scratch_address);
    record_builds(s, "accel/top_level", {a.tlas_input});
}

void RayQueryAccel::append_model(const DeviceScene& scene) {
    Impl& a = *impl_;
    const std::vector<SurfelModel>& models = scene.layout().models;
    if (scene.size() * a.floats_per_surfel() > a.geometry.size())
        reserve_spare(scene.size(), [&](std::size_t n) {
            a.geometry.reserve(a.device, n * a.floats_per_surfel(), "proxies");
        });
    a.reserve_indices(models.back().count);
    // The radius of a new model must be 0 before the kernel computes its maximum.
    std::vector<std::uint32_t> radii = a.radii.download();
    radii.resize(models.size(), 0u);
    a.radii = {a.device, radii, "radii of models"};
    // The array of the proxies may have moved, so all models get their new addresses.
    while (a.blas.size() < models.size()) a.allocate_blas(models[a.blas.size()]);
    for (std::size_t i = 0; i < models.size(); ++i) a.set_geometry(a.blas_input[i], models[i]);
    a.allocate_scratch();
}

void RayQueryAccel::append_instances(const DeviceScene& scene) {
    Impl& a = *impl_;
    const std::size_t n = scene.layout().instances.size();
    if (n <= a.moving.size()) return;
    reserve_spare(n, [&](std::size_t capacity) {
        a.allocate_tlas(capacity);
        a.moving = {a.device, capacity, "moving instances"};
    });
    a.allocate_scratch();
}

void RayQueryAccel::write_addresses(AccelAddresses& addresses) const {
    const Impl& a = *impl_;
    addresses.tlas = {a.tlas->address};
    // Kernels store this float as an integer, because atomic maxima need integers.
    // Positive floats have the same order as their bits.
    addresses.proxy_reach = a.reach.address_as<float, shared::ProxyReach>();
    addresses.moving = a.moving.address();
    addresses.model_radii = a.radii.address_as<float, shared::ModelRadii>();  // also stored as float bits
    addresses.n_moving = a.n_moving;
}

}  // namespace relidar
