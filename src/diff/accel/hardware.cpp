// SPDX-License-Identifier: Apache-2.0
#include "diff/accel/hardware.hpp"

#include <algorithm>
#include <utility>

#include "diff/shared/accel.h"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

using enum SpecialisationConstantId;

/// An acceleration structure of the driver, and the memory that holds it.
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
            infos.back().pGeometries = &input.geometry;  // of this copy
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

constexpr std::uint32_t kBoxBytes = 6 * sizeof(float), kVertexBytes = 3 * sizeof(float);

/// Returns the cull mask (8 bits) of the k-th moving instance. Bit 0 is for standing
/// instances. A separate ray query tests each moving instance, because its pose depends
/// on the time of the ray. So they have different bits, which are reused after 7.
std::uint32_t moving_instance_mask(std::size_t k) {
    return RELIDAR_STANDING_MASK << (1 + k % RELIDAR_MOVING_MASKS);
}

/// Describes an instance (a placed model) to the driver.
/// @param index index of the instance, which a ray query reports for a hit
/// @param mask a ray query finds the instance only if it selects a common bit
/// @param blas_address acceleration structure of the model
VkAccelerationStructureInstanceKHR make_vk_instance(std::size_t index, const glm::mat4& world_from_model,
                                                    std::uint32_t mask, std::uint64_t blas_address) {
    VkAccelerationStructureInstanceKHR result{};
    // Vulkan stores the upper three rows of the matrix. glm stores columns.
    for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 4; ++column)
            result.transform.matrix[row][column] = world_from_model[column][row];
    result.instanceCustomIndex = std::uint32_t(index) & 0xffffffu;  // a bit field with 24 bits
    result.mask = mask & 0xffu;                                     // a bit field with 8 bits
    // Proxies enclose surfels, so rays also enter them through the back of a triangle.
    result.flags = VK_GEOMETRY_INSTANCE_TRIANGLE_FACING_CULL_DISABLE_BIT_KHR;
    result.accelerationStructureReference = blas_address;
    return result;
}

/// The instances for the driver, and those of them that move during a sweep.
struct InstanceLists {
    std::vector<VkAccelerationStructureInstanceKHR> all;
    std::vector<shared::MovingInstance> moving;
};

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
    /// Gaussian and a corner of its icosahedron. A ray query searches this far behind the
    /// farthest hit, because it may find only the far side of the icosahedron.
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

    /// Floats of a proxy: a box, or the corners of a mesh.
    std::size_t floats_per_surfel() const {
        const std::size_t bytes = proxy == ProxyShape::boxes ? kBoxBytes : kVertexBytes * mesh.n_corners;
        return bytes / sizeof(float);
    }
    void set_geometry(BuildInput& input, const SurfelModel& model) const;
    void set_instance_geometry();
    void reserve_indices(std::uint32_t n_surfels);
    void allocate_blas(const SurfelModel& model);
    void allocate_tlas(std::size_t n_instances);
    void allocate_scratch();
    std::uint64_t align_scratch(std::uint64_t bytes) const {
        const std::uint64_t alignment = device.impl().scratch_alignment;
        return (bytes + alignment - 1) / alignment * alignment;
    }
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
    InstanceLists list_instances(const DeviceScene& scene) const;
};

/// Sets `input` to the proxies of one model: boxes or triangles around each
/// surfel, in a part of the array `geometry`. They are not marked as opaque, so that the
/// shader tests every candidate hit.
void RayQueryAccel::Impl::set_geometry(BuildInput& input, const SurfelModel& model) const {
    const std::size_t first_float = floats_per_surfel() * model.first;
    const std::uint64_t first_proxy = geometry.buffer().impl().address + sizeof(float) * first_float;
    if (proxy == ProxyShape::boxes) {
        input.geometry.geometryType = VK_GEOMETRY_TYPE_AABBS_KHR;
        input.geometry.geometry.aabbs = {
            .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_AABBS_DATA_KHR,
            .pNext = nullptr,
            .data = {.deviceAddress = first_proxy},
            .stride = kBoxBytes};
    } else {
        input.geometry.geometryType = VK_GEOMETRY_TYPE_TRIANGLES_KHR;
        const std::uint32_t n_meshes = std::max(model.count, 1u);  // avoids -1 for an empty model
        input.geometry.geometry.triangles = {
            .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_TRIANGLES_DATA_KHR,
            .pNext = nullptr,
            .vertexFormat = VK_FORMAT_R32G32B32_SFLOAT,
            .vertexData = {.deviceAddress = first_proxy},
            .vertexStride = kVertexBytes,
            .maxVertex = mesh.n_corners * n_meshes - 1,
            .indexType = VK_INDEX_TYPE_UINT32,
            .indexData = {.deviceAddress = indices.buffer().impl().address},
            .transformData = {}};
    }
    input.info.type = VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR;
    input.info.flags = VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR |
                       VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_UPDATE_BIT_KHR;
}

/// Describes the geometry of the top-level structure, which consists of instances.
void RayQueryAccel::Impl::set_instance_geometry() {
    tlas_input.geometry.geometryType = VK_GEOMETRY_TYPE_INSTANCES_KHR;
    tlas_input.geometry.geometry.instances = {
        VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_INSTANCES_DATA_KHR, nullptr, VK_FALSE, {}};
    tlas_input.info.type = VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR;
    tlas_input.info.flags = VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR;
}

/// Lists the instances at their current poses. Leaves out absent instances and models
/// without surfels. Moving instances get masks with which kernels find each of them.
InstanceLists RayQueryAccel::Impl::list_instances(const DeviceScene& scene) const {
    const std::vector<ModelInstance>& instances = scene.layout().instances;
    InstanceLists lists;
    for (std::size_t i = 0; i < instances.size(); ++i) {
        const InstancePose& pose = scene.poses()[i];
        const std::uint32_t model = instances[i].model;
        if (!blas[model] || !pose.present) continue;
        std::uint32_t mask = RELIDAR_STANDING_MASK;
        if (!pose.motion.is_stationary()) {
            mask = moving_instance_mask(lists.moving.size());
            lists.moving.push_back({std::uint32_t(i), model, mask});
        }
        const glm::mat4 world_from_model(to_matrix(pose.world_from_model));
        lists.all.push_back(make_vk_instance(i, world_from_model, mask, blas[model]->address));
    }
    return lists;
}

/// Writes the triangle indices of `n_surfels` proxies, unless enough exist. All models
/// use the first of these indices, so `n_surfels` is the size of the largest model.
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

/// Allocates the bottom-level structure (BLAS) of a model, and assigns a part of the
/// scratch buffer to its builds. `scratch_bytes` is the end of the parts so far.
void RayQueryAccel::Impl::allocate_blas(const SurfelModel& model) {
    BuildInput& input = blas_input.emplace_back();
    set_geometry(input, model);
    blas_scratch.push_back(scratch_bytes);
    blas.push_back(nullptr);
    if (model.count == 0) return;
    const auto n_triangles = std::uint32_t(mesh.corners.size() / 3);
    const std::uint32_t n_primitives = model.count * (proxy == ProxyShape::boxes ? 1u : n_triangles);
    const VkAccelerationStructureBuildSizesInfoKHR sizes = input.query_sizes(device.impl(), n_primitives);
    blas.back() = std::make_unique<VulkanAccelStructure>(
        device, VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR, sizes.accelerationStructureSize,
        "acceleration structure of " + model.name);
    scratch_bytes += align_scratch(std::max(sizes.buildScratchSize, sizes.updateScratchSize));
}

/// Allocates the top-level structure (TLAS). Its build shares the scratch memory of the
/// models, because it starts after their builds.
void RayQueryAccel::Impl::allocate_tlas(std::size_t n_instances) {
    const VkAccelerationStructureBuildSizesInfoKHR sizes =
        tlas_input.query_sizes(device.impl(), std::uint32_t(std::max<std::size_t>(n_instances, 1)));
    tlas = std::make_unique<VulkanAccelStructure>(device, VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR,
                                                  sizes.accelerationStructureSize, "top level");
    scratch_bytes = std::max(scratch_bytes, sizes.buildScratchSize);
}

/// Allocates the scratch buffer of all builds, unless it is large enough. Vulkan requires
/// an aligned address, so the buffer is larger by one alignment.
void RayQueryAccel::Impl::allocate_scratch() {
    const std::uint64_t n_bytes = scratch_bytes + device.impl().scratch_alignment;
    if (scratch && n_bytes <= scratch.size_bytes()) return;
    scratch = Buffer(device, n_bytes, "acceleration structure scratch");
    scratch_address = align_scratch(scratch.impl().address);
}

/// Allocates the structures of all models and of the instances, which record_build()
/// builds, and one scratch buffer for all builds, in which each model has a part.
RayQueryAccel::RayQueryAccel(Device& device, const DeviceScene& scene, ProxyShape proxy) {
    impl_ = std::make_unique<Impl>(device, scene.layout(), proxy, scene.primitive());
    Impl& a = *impl_;
    const Scene& layout = scene.layout();
    std::uint32_t n_largest = 0;  // number of surfels of the largest model
    for (const SurfelModel& model : layout.models) n_largest = std::max(n_largest, model.count);
    a.geometry = Array<float>(device, scene.size() * a.floats_per_surfel(), "proxies");
    a.reserve_indices(n_largest);
    for (const SurfelModel& model : layout.models) a.allocate_blas(model);
    a.set_instance_geometry();
    a.allocate_tlas(layout.instances.size());
    a.allocate_scratch();
}

RayQueryAccel::~RayQueryAccel() = default;

void RayQueryAccel::record_build(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                                 const SurfelRanges& ranges, BuildMode mode) {
    Impl& a = *impl_;
    std::uint32_t n_updated = 0;
    for (const SurfelRange& range : ranges) n_updated += range.count;
    // `reach` and `radii` are maxima over surfels, which the kernels only increase. A
    // reset requires an update of all surfels, because the maxima would miss the others.
    const bool updates_all = n_updated == scene.size();
    if (updates_all && a.reach.size() > 0) stream.fill(a.reach);
    for (const SurfelRange& range : ranges) a.compute_proxies(stream, scene, options, range);
    if (updates_all) stream.fill(a.radii);
    for (const SurfelRange& range : ranges) a.compute_radii(stream, scene, options, range);

    std::vector<BuildInput> inputs;
    for (std::size_t i = 0; i < a.blas.size(); ++i) {
        const auto contains_model = [&](const SurfelRange& range) {
            return range.contains_surfel(scene.layout().models[i].first);
        };
        if (!a.blas[i] || std::ranges::none_of(ranges, contains_model)) continue;
        a.blas_input[i].set_target(*a.blas[i], mode == BuildMode::refit,
                                   a.scratch_address + a.blas_scratch[i]);
        inputs.push_back(a.blas_input[i]);
    }
    if (!inputs.empty())
        record_builds(stream.impl(), mode == BuildMode::refit ? "accel/refit" : "accel/build",
                      std::move(inputs));
    rebuild_top_level(stream, scene);
}

/// Records a full build of the top-level structure, because a refit cannot add instances.
/// Also writes the list of moving instances, which ray queries test one by one.
void RayQueryAccel::rebuild_top_level(Stream& stream, const DeviceScene& scene) {
    Impl& a = *impl_;
    const bool update = false;
    Stream::Impl& s = stream.impl();
    const InstanceLists lists = a.list_instances(scene);
    a.n_moving = std::uint32_t(lists.moving.size());
    s.record_write(a.moving.buffer(), lists.moving.data(), a.n_moving * sizeof(lists.moving[0]));
    a.tlas_input.range.primitiveCount = std::uint32_t(lists.all.size());
    a.tlas_input.geometry.geometry.instances.data.deviceAddress =
        s.stage_bytes(lists.all.data(), lists.all.size() * sizeof(lists.all[0])).address;
    a.tlas_input.set_target(*a.tlas, update, a.scratch_address);
    record_builds(s, "accel/top_level", {a.tlas_input});
}

void RayQueryAccel::append_model(const DeviceScene& scene) {
    Impl& a = *impl_;
    const std::vector<SurfelModel>& models = scene.layout().models;
    if (scene.size() * a.floats_per_surfel() > a.geometry.size())
        reserve_spare(scene.size(), [&](std::size_t n_surfels) {
            a.geometry.reserve(a.device, n_surfels * a.floats_per_surfel(), "proxies");
        });
    a.reserve_indices(models.back().count);
    // Adds a radius of 0, because a kernel computes it as a maximum over the surfels.
    std::vector<std::uint32_t> radii = a.radii.download();
    radii.resize(models.size(), 0u);
    a.radii = {a.device, radii, "radii of models"};
    while (a.blas.size() < models.size()) a.allocate_blas(models[a.blas.size()]);
    // The addresses of `geometry` and `indices` may have changed for all models.
    for (std::size_t i = 0; i < models.size(); ++i) a.set_geometry(a.blas_input[i], models[i]);
    a.allocate_scratch();
}

void RayQueryAccel::reserve_instances(const DeviceScene& scene) {
    Impl& a = *impl_;
    const std::size_t n_instances = scene.layout().instances.size();
    if (n_instances <= a.moving.size()) return;
    reserve_spare(n_instances, [&](std::size_t capacity) {
        a.allocate_tlas(capacity);
        a.moving = {a.device, capacity, "moving instances"};
    });
    a.allocate_scratch();
}

AccelAddresses RayQueryAccel::addresses() const {
    const Impl& a = *impl_;
    AccelAddresses addresses;
    addresses.tlas = {a.tlas->address};
    addresses.moving = a.moving.address();
    addresses.n_moving = a.n_moving;
    // Other kernels write these two lengths with atomic maxima of integers. They can be
    // read as floats, because positive floats have the same order as their bits.
    addresses.proxy_reach = a.reach.address_as<float, shared::ProxyReach>();
    addresses.model_radii = a.radii.address_as<float, shared::ModelRadii>();
    return addresses;
}

}  // namespace relidar
