// SPDX-License-Identifier: Apache-2.0
// Stores a scene on the device: the parameter arrays, the surfel records, and the tables
// of models and instances. Runs the kernels that compute the surfel records from the
// parameters, and those for the gradients.

#include <cmath>

#include <relidar/scene/device_scene.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"
#include "gpu/stream.hpp"
#include "scene/shared/scene.h"

namespace relidar {

static_assert(sizeof(shared::SurfelRecord) == 64 && sizeof(shared::InstanceEntry) == 96 &&
              sizeof(shared::ModelEntry) == 32);

namespace {

std::vector<SpecialisationConstant> make_constants(bool stage_sh_in_shared_memory) {
    std::vector<SpecialisationConstant> all{
        {SpecialisationConstantId::STAGED, stage_sh_in_shared_memory ? 1u : 0u}};
    // Limits a workgroup to 64 threads, so that it needs only 4.4 kB of shared memory.
    if (stage_sh_in_shared_memory) all.push_back({SpecialisationConstantId::WORKGROUP_SIZE, 64u});
    return all;
}

/// Rows of the array of gradients of surfel records. It has a row for each surfel of each
/// instance. The first instance of each model uses the rows of its surfels. The blocks of
/// rows of the further instances follow, sorted by model.
struct InstanceGradientRows {
    std::vector<std::uint32_t> first_row;  ///< [instances] first gradient row of each instance
    /// [models] index of the first instance of each model, or -1
    std::vector<std::int64_t> first_instance;
    /// first gradient row of the second, third, ... instance of each model, by model
    std::vector<std::uint32_t> further_rows;
    std::vector<std::uint32_t> first_further;  ///< [models + 1] start of each model in `further_rows`
    std::uint32_t n_rows;

    InstanceGradientRows(const Scene& scene, std::uint32_t n_surfels)
        : first_row(scene.instances.size()),
          first_instance(scene.models.size(), -1),
          first_further(scene.models.size() + 1, 0),
          n_rows(n_surfels) {
        std::vector<std::uint32_t> n_instances(scene.models.size(), 0);
        for (const ModelInstance& instance : scene.instances) ++n_instances[instance.model];
        // Reserves a block of rows for each further instance, after all surfels.
        std::vector<std::uint32_t> next_block(scene.models.size());  // first row of the next free block
        for (std::size_t model = 0; model < scene.models.size(); ++model) {
            next_block[model] = n_rows;
            for (std::uint32_t k = 1; k < n_instances[model]; ++k) {
                further_rows.push_back(n_rows);
                n_rows += scene.models[model].count;
            }
            first_further[model + 1] = static_cast<std::uint32_t>(further_rows.size());
        }

        // The first instance uses the rows of the surfels, others the next block.
        for (std::size_t i = 0; i < scene.instances.size(); ++i) {
            const std::uint32_t model = scene.instances[i].model;
            if (first_instance[model] < 0) {
                first_instance[model] = static_cast<std::int64_t>(i);
                first_row[i] = scene.models[model].first;
            } else {
                first_row[i] = next_block[model];
                next_block[model] += scene.models[model].count;
            }
        }
    }
};

/// Returns the model table for the device: for each model, its surfels and box, and which
/// elements of `rows.further_rows` belong to its instances.
std::vector<shared::ModelEntry> make_models(const Scene& scene, const InstanceGradientRows& rows) {
    std::vector<shared::ModelEntry> entries;
    for (std::size_t i = 0; i < scene.models.size(); ++i) {
        const SurfelModel& model = scene.models[i];
        entries.push_back({.first_surfel = model.first,
                           .n_surfels = model.count,
                           .half_size = model.half_size_m,
                           .half_diagonal = glm::length(model.half_size_m),
                           .first_more = rows.first_further[i],
                           .n_more = rows.first_further[i + 1] - rows.first_further[i]});
    }
    return entries;
}

}  // namespace

struct DeviceScene::Impl {
    Scene layout;
    InstanceGradientRows gradient_rows;
    Array<shared::ModelEntry> models;
    Array<std::uint32_t, shared::FurtherRows> further_rows;  ///< InstanceGradientRows::further_rows
    SurfelArrays parameters;
    Array<shared::SurfelRecord> records;
    Array<shared::InstanceEntry> instances;
    std::vector<InstancePose> poses;
    float alpha_min = ImageModel{}.alpha_min;
    Kernel<shared::ActivateParams> activate;
    Kernel<shared::ActivateVjpParams> activate_vjp;
    /// List of the surfels that have a gradient. Not used by kernels that keep spherical
    /// harmonics in shared memory, because they copy consecutive surfels.
    std::optional<TouchedSurfelList> touched_list;

    /// Uploads the tables of a scene and allocates the arrays of its surfels, which stay
    /// empty. The poses of the instances are not set yet.
    Impl(Device& device, const Scene& scene, bool stage_harmonics)
        : layout(strip_surfels(scene)),
          gradient_rows(scene, static_cast<std::uint32_t>(scene.surfels.size())),
          models(device, make_models(scene, gradient_rows), "model table"),
          further_rows(device, gradient_rows.further_rows, "gradient rows of further instances"),
          parameters(device, static_cast<std::uint32_t>(scene.surfels.size()), "surfel",
                     scene.surfels.parameters_used()),
          records(device, scene.surfels.size(), "surfel records"),
          instances(device, scene.instances.size(), "instance table"),
          activate(device, "scene/activate", make_constants(stage_harmonics)),
          activate_vjp(device, "scene/activate_vjp", make_constants(stage_harmonics)) {
        if (!stage_harmonics) touched_list.emplace(device);
    }

    std::uint32_t count_models() const { return static_cast<std::uint32_t>(layout.models.size()); }

    /// Stores the poses of all instances, and returns the instance table for the device.
    /// Each entry has the transform from world to model, the motion, and the range of
    /// surfels, which is empty for an absent instance.
    std::vector<shared::InstanceEntry> make_instances(const std::vector<InstancePose>& instance_poses) {
        if (instance_poses.size() != layout.instances.size())
            fail("cannot place the instances: found {} poses, expected {}, one for each instance",
                 instance_poses.size(), layout.instances.size());
        poses = instance_poses;
        std::vector<shared::InstanceEntry> entries;
        for (std::size_t i = 0; i < instance_poses.size(); ++i) {
            const PoseMotion& motion = instance_poses[i].motion;
            const Pose model_from_world = inverse(instance_poses[i].world_from_model);
            const glm::mat4 rows = glm::transpose(glm::mat4(to_matrix(model_from_world)));
            const SurfelModel& model = layout.models[layout.instances[i].model];
            entries.push_back(
                {.row0 = rows[0],
                 .row1 = rows[1],
                 .row2 = rows[2],
                 .first_surfel = model.first,
                 .n_surfels = instance_poses[i].present ? model.count : 0u,
                 .first_row = gradient_rows.first_row[i],
                 .moves = motion.is_stationary() ? 0u : 1u,
                 .velocity = glm::vec3(model_from_world.rotation * motion.velocity_mps),
                 .middle_s = static_cast<float>(motion.middle_s),
                 .turn_rate = glm::vec3(model_from_world.rotation * motion.angular_velocity_radps),
                 .half_span_s = static_cast<float>(motion.half_span_s)});
        }
        return entries;
    }

    /// Uploads the view origin in the frame of each model (of its first instance).
    /// @return [models] device array that only the next submission can read
    Address<glm::vec3> upload_origins(Stream& stream, const glm::vec3& view_origin_world_m) const {
        std::vector<glm::vec3> origins;
        for (const std::int64_t i : gradient_rows.first_instance)
            origins.push_back(i < 0 ? view_origin_world_m
                                    : glm::vec3(inverse(poses[static_cast<std::size_t>(i)].world_from_model) *
                                                glm::dvec3(view_origin_world_m)));
        return stream.impl().stage_values(origins);
    }

    /// Uploads the phase of the walking motion of each model (of its first instance).
    /// @return [models] phase as a fraction of a stride, 0..1; negative for rigid models;
    /// null if all models are rigid
    Address<float, shared::GaitPhases> upload_phases(Stream& stream) const {
        if (!parameters.bends) return {};
        std::vector<float> phases;
        for (std::size_t m = 0; m < layout.models.size(); ++m) {
            const std::int64_t i = gradient_rows.first_instance[m];
            const double strides = i < 0 ? 0.0 : poses[static_cast<std::size_t>(i)].phase;
            const bool walks = layout.models[m].stride_m > 0.0f;
            phases.push_back(walks ? static_cast<float>(strides - std::floor(strides)) : -1.0f);
        }
        return stream.impl().stage_values(phases).cast_tag<shared::GaitPhases>();
    }
};

DeviceScene::DeviceScene(Device& device, const Scene& scene, std::optional<bool> stage_harmonics) {
    check_layout(scene);
    impl_ = std::make_unique<Impl>(device, scene, stage_harmonics.value_or(should_coalesce(device)));
    impl_->parameters.upload(scene.surfels);
    upload_poses(std::vector<Pose>(scene.instances.size()));
}

DeviceScene::~DeviceScene() = default;

void DeviceScene::upload_poses(const std::vector<Pose>& world_from_instance) {
    std::vector<InstancePose> placed;
    for (const Pose& pose : world_from_instance) placed.push_back({pose});
    upload_poses(placed);
}

void DeviceScene::upload_poses(const std::vector<InstancePose>& placed) {
    impl_->instances.upload(impl_->make_instances(placed));
}

void DeviceScene::stage_poses(Stream& stream, const std::vector<InstancePose>& placed) {
    const std::vector<shared::InstanceEntry> entries = impl_->make_instances(placed);
    stream.impl().record_write(impl_->instances.buffer(), entries.data(),
                               entries.size() * sizeof(entries[0]));
}

void DeviceScene::activate(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m) {
    impl_->alpha_min = model.alpha_min;
    if (size() == 0) return;
    if (primitive() != model.primitive)
        fail<UsageError>("found image.primitive={}, expected {}, the primitive of the trained scene",
                         properties_of(model.primitive).name, properties_of(primitive()).name);
    run(stream, impl_->activate, size(),
        {.surfels = surfel_pointers(impl_->parameters),
         .records = impl_->records.address(),
         .models = impl_->models.address(),
         .view_origins = impl_->upload_origins(stream, view_origin_m),  // [models]
         .phases = impl_->upload_phases(stream),                        // [models], of walking actors
         .alpha_min = model.alpha_min,
         .n_surfels = size(),
         .n_models = impl_->count_models(),
         .sh_degree = static_cast<std::uint32_t>(model.sh_degree),
         .sh_per_surfel = model.sh_direction == ShDirection::surfel ? 1u : 0u});
}

bool DeviceScene::can_skip_surfels() const { return impl_->touched_list.has_value(); }

void DeviceScene::activate_vjp(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m,
                               const ActivationGradients& gradients) {
    if (size() == 0) return;
    // A thread per surfel, or threads for a list of the surfels that rays hit. The list
    // needs the marks of the backward pass, and the other surfels must not need zeros.
    const bool has_list = can_skip_surfels() && gradients.touched_is_marked && !gradients.zero_untouched;
    std::size_t n_threads = size();
    Address<std::uint32_t, shared::TouchedRows> listed_surfels;  // null: all surfels
    Address<std::uint32_t, shared::TouchedCount> n_listed;       // in device memory
    if (has_list) {
        TouchedSurfelList& list = *impl_->touched_list;
        list.compact(stream, gradients.touched->address(), size());
        n_threads = list.choose_threads(size());
        listed_surfels = list.rows_address();
        n_listed = list.count_address();
    }
    run(stream, impl_->activate_vjp, n_threads,
        {.surfels = surfel_pointers(impl_->parameters),
         .d_records = gradients.d_records->address(),
         .models = impl_->models.address(),
         // Rows of d_records of a model's other instances, which the kernel adds.
         .more_rows = impl_->further_rows.address(),
         .view_origins = impl_->upload_origins(stream, view_origin_m),
         .phases = impl_->upload_phases(stream),
         .d_surfels = surfel_pointers(*gradients.d_surfels),
         .touched = gradients.touched->address(),
         .rows = listed_surfels,
         .n_listed = n_listed,
         .d_view = address_or_null(gradients.d_view),
         .n_surfels = size(),
         .n_models = impl_->count_models(),
         .sh_degree = static_cast<std::uint32_t>(model.sh_degree),
         .sh_per_surfel = model.sh_direction == ShDirection::surfel ? 1u : 0u,
         .zero_untouched = gradients.zero_untouched ? 1u : 0u});
}

void DeviceScene::reserve(Device& device, std::uint32_t capacity) {
    impl_->parameters.reserve(device, capacity, "surfel");
    impl_->records.reserve(device, capacity, "surfel records");
}

void DeviceScene::set_models(const std::vector<SurfelModel>& models) {
    const std::uint32_t n = models.empty() ? 0u : models.back().first + models.back().count;
    RELIDAR_ASSERT_LE(n, impl_->parameters.capacity());
    RELIDAR_ASSERT_LE(std::size_t(n), impl_->records.size());
    impl_->layout.models = models;
    impl_->parameters.n = n;
    // Each instance has a row of gradients per surfel, so the first rows change with the
    // numbers of surfels. The tables keep their sizes, because the instances stay.
    impl_->gradient_rows = InstanceGradientRows(impl_->layout, n);
    impl_->models.upload(make_models(impl_->layout, impl_->gradient_rows));
    impl_->further_rows.upload(impl_->gradient_rows.further_rows);
}

void DeviceScene::append_model(Device& device, const DeviceScene& added) {
    Impl& scene = *impl_;
    const std::uint32_t first = size(), n = first + added.size();
    if (n > scene.parameters.capacity() || n > scene.records.size())
        reserve_spare(n, [&](std::size_t capacity) { reserve(device, std::uint32_t(capacity)); });
    // Allocates before it changes this scene, because memory may be exhausted.
    Scene layout = scene.layout;
    layout.models.push_back(added.layout().models.front());
    layout.models.back().first = first;
    InstanceGradientRows rows(layout, n);
    Array<shared::ModelEntry> models(device, make_models(layout, rows), "model table");
    Array<std::uint32_t, shared::FurtherRows> further_rows(device, rows.further_rows,
                                                           "gradient rows of further instances");
    scene.parameters.upload_at(first, added.surfel_parameters().download());
    scene.records.upload(added.surfel_records().download(added.size()), first);
    scene.parameters.n = n;
    scene.layout = std::move(layout);
    scene.gradient_rows = std::move(rows);
    scene.models = std::move(models);
    scene.further_rows = std::move(further_rows);
}

void DeviceScene::append_instance(Device& device, const ModelInstance& instance) {
    Impl& scene = *impl_;
    const std::size_t n = scene.layout.instances.size() + 1;
    if (n > scene.instances.size())
        reserve_spare(n, [&](std::size_t capacity) {
            scene.instances = Array<shared::InstanceEntry>(device, capacity, "instance table");
        });
    scene.layout.instances.push_back(instance);
    // The instance stays absent until its pose is set.
    scene.poses.push_back({.present = false});
    // A further instance of a model gets rows of gradients, which moves the rows of later
    // models. All tables contain such rows.
    scene.gradient_rows = InstanceGradientRows(scene.layout, size());
    scene.models.upload(make_models(scene.layout, scene.gradient_rows));
    scene.further_rows = {device, scene.gradient_rows.further_rows, "gradient rows of further instances"};
    scene.instances.upload(scene.make_instances(std::vector<InstancePose>(scene.poses)));
}

bool DeviceScene::moves_gait(const std::vector<InstancePose>& placed) const {
    if (!impl_->parameters.bends) return false;
    for (std::size_t i = 0; i < std::min(placed.size(), impl_->poses.size()); ++i) {
        const bool bends = impl_->layout.models[impl_->layout.instances[i].model].stride_m > 0.0f;
        if (bends && placed[i].present && placed[i].phase != impl_->poses[i].phase) return true;
    }
    return false;
}

const std::vector<InstancePose>& DeviceScene::poses() const { return impl_->poses; }
const Scene& DeviceScene::layout() const { return impl_->layout; }
SurfelArrays& DeviceScene::surfel_parameters() { return impl_->parameters; }
const SurfelArrays& DeviceScene::surfel_parameters() const { return impl_->parameters; }
const Array<shared::SurfelRecord>& DeviceScene::surfel_records() const { return impl_->records; }
const Array<shared::ModelEntry>& DeviceScene::model_table() const { return impl_->models; }
const Array<shared::InstanceEntry>& DeviceScene::instance_table() const { return impl_->instances; }
float DeviceScene::alpha_min() const { return impl_->alpha_min; }
PrimitiveType DeviceScene::primitive() const { return impl_->parameters.primitive; }
std::uint32_t DeviceScene::size() const { return impl_->parameters.n; }
std::uint32_t DeviceScene::first_gradient_row(std::size_t instance_index) const {
    return impl_->gradient_rows.first_row[instance_index];
}
std::uint32_t DeviceScene::count_rows() const { return impl_->gradient_rows.n_rows; }

struct TouchedSurfelList::Impl {
    Device& device;
    Array<std::uint32_t, shared::TouchedRows> rows;
    Array<std::uint32_t, shared::TouchedCount> count;
    Kernel<shared::ListTouchedParams> kernel;
};

/// Makes an empty list: compact() allocates its rows.
TouchedSurfelList::TouchedSurfelList(Device& device)
    : impl_(new Impl{
          .device = device,
          .rows = {},
          .count = {device, 1, "number of rows with a gradient"},
          .kernel = {device, "scene/list_touched", {{SpecialisationConstantId::WORKGROUP_SIZE, 128u}}}}) {}
TouchedSurfelList::~TouchedSurfelList() = default;

void TouchedSurfelList::compact(Stream& stream, Address<std::uint32_t, shared::TouchedSurfels> touched,
                                std::uint32_t n) {
    Impl& list = *impl_;
    if (list.rows.size() < n) {
        stream.submit_and_wait();  // earlier submissions may still use the old array
        list.rows.reserve(list.device, n, "rows with a gradient");
    }
    stream.fill(list.count);  // resets the counter to 0
    // Each thread checks RELIDAR_LIST_STRETCH rows.
    run(stream, list.kernel, (n + RELIDAR_LIST_STRETCH - 1) / RELIDAR_LIST_STRETCH,
        {.touched = touched, .rows = list.rows.address(), .count = list.count.address(), .n_rows = n});
}

Address<std::uint32_t, shared::TouchedRows> TouchedSurfelList::rows_address() const {
    return impl_->rows.address();
}
Address<std::uint32_t, shared::TouchedCount> TouchedSurfelList::count_address() const {
    return impl_->count.address();
}

std::size_t TouchedSurfelList::choose_threads(std::size_t max_touched_rows) const {
    constexpr std::size_t kCpuThreads = 1 << 12, kGpuThreads = 1 << 17;
    const bool is_cpu = !should_coalesce(impl_->device);
    return std::min(max_touched_rows, is_cpu ? kCpuThreads : kGpuThreads);
}

}  // namespace relidar
