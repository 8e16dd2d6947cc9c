// SPDX-License-Identifier: Apache-2.0
// Stores a scene on the device: the parameter arrays, the surfel records, and the tables
// of models and instances. Runs the activation kernels, which compute the surfel records
// from the parameters. Also runs the kernels that compute the gradients of the
// parameters.

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

/// Rows of each instance (a model with a pose) in the gradient array, one row per surfel.
/// In the first instance of a model, the row of a surfel is the surfel's index. The rows
/// of all other instances follow after these rows, sorted by model.
struct InstanceGradientRows {
    std::vector<std::uint32_t> first_row;  ///< [instances] first gradient row of each instance
    /// [models] index of the first instance of each model, or -1
    std::vector<std::int64_t> first_instance;
    /// first gradient row of the second, third, ... instance of each model, by model
    std::vector<std::uint32_t> more;
    /// [models + 1] start of each model in `more`
    std::vector<std::uint32_t> first_more;
    std::uint32_t n_rows;

    InstanceGradientRows(const Scene& scene, std::uint32_t n_surfels)
        : first_row(scene.instances.size()),
          first_instance(scene.models.size(), -1),
          first_more(scene.models.size() + 1, 0),
          n_rows(n_surfels) {
        std::vector<std::uint32_t> placed(scene.models.size(), 0);
        for (const ModelInstance& instance : scene.instances) ++placed[instance.model];
        std::vector<std::uint32_t> next_row(scene.models.size());
        for (std::size_t model = 0; model < scene.models.size(); ++model) {
            const std::uint32_t n_more = std::max(placed[model], 1u) - 1;
            first_more[model + 1] = first_more[model] + n_more;
            // The rows of the second and later instances follow all surfels.
            next_row[model] = n_rows;
            n_rows += n_more * scene.models[model].count;
            for (std::uint32_t k = 0; k < n_more; ++k)
                more.push_back(next_row[model] + k * scene.models[model].count);
        }
        for (std::size_t i = 0; i < scene.instances.size(); ++i) {
            const std::uint32_t model = scene.instances[i].model;
            first_row[i] = scene.models[model].first;
            // The first instance uses the rows of the surfels, others the next block.
            if (first_instance[model] < 0) first_instance[model] = static_cast<std::int64_t>(i);
            else first_row[i] = std::exchange(next_row[model], next_row[model] + scene.models[model].count);
        }
    }
};

std::vector<shared::ModelEntry> make_models(const Scene& scene, const InstanceGradientRows& rows) {
    std::vector<shared::ModelEntry> entries;
    for (std::size_t i = 0; i < scene.models.size(); ++i) {
        const SurfelModel& model = scene.models[i];
        entries.push_back({.first_surfel = model.first,
                           .n_surfels = model.count,
                           .half_size = model.half_size_m,
                           .half_diagonal = glm::length(model.half_size_m),
                           .first_more = rows.first_more[i],
                           .n_more = rows.first_more[i + 1] - rows.first_more[i]});
    }
    return entries;
}

}  // namespace

struct DeviceScene::Impl {
    Scene layout;
    InstanceGradientRows placements;
    Array<shared::ModelEntry> models;
    Array<std::uint32_t, shared::FurtherRows> more_rows;
    SurfelArrays parameters;
    Array<shared::SurfelRecord> records;
    Array<shared::InstanceEntry> instances;
    std::vector<InstancePose> poses;
    float alpha_min = ImageModel{}.alpha_min;
    Kernel<shared::ActivateParams> activate;
    Kernel<shared::ActivateVjpParams> activate_vjp;
    /// List of the surfels that have a gradient. Not used by kernels that keep spherical
    /// harmonics in shared memory.
    std::optional<TouchedSurfelList> list;

    Impl(Device& device, const Scene& scene, bool stage_harmonics)
        : layout(strip_surfels(scene)),
          placements(scene, static_cast<std::uint32_t>(scene.surfels.size())),
          models(device, make_models(scene, placements), "model table"),
          more_rows(device, placements.more, "gradient rows of further instances"),
          parameters(device, static_cast<std::uint32_t>(scene.surfels.size()), "surfel",
                     scene.surfels.parameters_used()),
          records(device, scene.surfels.size(), "surfel records"),
          instances(device, scene.instances.size(), "instance table"),
          activate(device, "scene/activate", make_constants(stage_harmonics)),
          activate_vjp(device, "scene/activate_vjp", make_constants(stage_harmonics)) {
        if (!stage_harmonics) list.emplace(device);
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
            const glm::mat4 m(to_matrix(model_from_world));
            const SurfelModel& model = layout.models[layout.instances[i].model];
            entries.push_back({{m[0].x, m[1].x, m[2].x, m[3].x},
                               {m[0].y, m[1].y, m[2].y, m[3].y},
                               {m[0].z, m[1].z, m[2].z, m[3].z},
                               model.first,
                               instance_poses[i].present ? model.count : 0u,
                               placements.first_row[i],
                               motion.is_stationary() ? 0u : 1u,
                               glm::vec3(model_from_world.rotation * motion.velocity_mps),
                               static_cast<float>(motion.middle_s),
                               glm::vec3(model_from_world.rotation * motion.angular_velocity_radps),
                               static_cast<float>(motion.half_span_s)});
        }
        return entries;
    }

    /// Uploads the view origin in the frame of each model (of its first instance).
    /// @return [models] device array that only the next submission can read
    Address<glm::vec3> upload_origins(Stream& stream, const glm::vec3& view_origin_world_m) const {
        std::vector<glm::vec3> origins;
        for (const std::int64_t i : placements.first_instance)
            origins.push_back(i < 0 ? view_origin_world_m
                                    : glm::vec3(inverse(poses[static_cast<std::size_t>(i)].world_from_model) *
                                                glm::dvec3(view_origin_world_m)));
        return stream.impl().stage_values(origins);
    }

    /// Uploads the phase of the walking motion of each model (of its first instance).
    /// @return [models] phase as a fraction of a stride, 0..1; negative for rigid models.
    Address<float> upload_phases(Stream& stream) const {
        if (!parameters.bends) return {};
        std::vector<float> all;
        for (std::size_t m = 0; m < layout.models.size(); ++m) {
            const std::int64_t i = placements.first_instance[m];
            const double turns = i < 0 ? 0.0 : poses[static_cast<std::size_t>(i)].phase;
            all.push_back(layout.models[m].stride_m > 0.0f ? static_cast<float>(turns - std::floor(turns))
                                                           : -1.0f);
        }
        return stream.impl().stage_values(all);
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

void DeviceScene::activate(Stream& stream, const ImageModel& model, const glm::vec3& origin_m) {
    impl_->alpha_min = model.alpha_min;
    if (size() == 0) return;
    if (primitive() != model.primitive)
        fail<UsageError>("found image.primitive={}, expected {}, the primitive of the trained scene",
                         properties_of(model.primitive).name, properties_of(primitive()).name);
    run(stream, impl_->activate, size(),
        {.surfels = surfel_pointers(impl_->parameters),
         .records = impl_->records.address(),
         .models = impl_->models.address(),
         .view_origins = impl_->upload_origins(stream, origin_m),
         .phases = impl_->upload_phases(stream).cast_tag<shared::GaitPhases>(),
         .alpha_min = model.alpha_min,
         .n_surfels = size(),
         .n_models = impl_->count_models(),
         .sh_degree = static_cast<std::uint32_t>(model.sh_degree),
         .sh_per_surfel = model.sh_direction == ShDirection::surfel ? 1u : 0u});
}

bool DeviceScene::can_skip_surfels() const { return impl_->list.has_value(); }

void DeviceScene::activate_vjp(Stream& stream, const ImageModel& model, const glm::vec3& origin_m,
                               const ActivationGradients& gradients) {
    if (size() == 0) return;
    // On a CPU, only surfels with a gradient are processed. If the others must be set to
    // zero, all surfels are processed.
    const bool listed = gradients.touched_is_marked && can_skip_surfels() && !gradients.zero_untouched;
    if (listed) impl_->list->compact(stream, gradients.touched->address(), size());
    run(stream, impl_->activate_vjp, listed ? impl_->list->choose_threads(size()) : size(),
        {.surfels = surfel_pointers(impl_->parameters),
         .d_records = gradients.d_records->address(),
         .models = impl_->models.address(),
         .more_rows = impl_->more_rows.address(),
         .view_origins = impl_->upload_origins(stream, origin_m),
         .phases = impl_->upload_phases(stream).cast_tag<shared::GaitPhases>(),
         .d_surfels = surfel_pointers(*gradients.d_surfels),
         .touched = gradients.touched->address(),
         .rows = listed ? impl_->list->rows_address() : Address<std::uint32_t, shared::TouchedRows>{},
         .n_listed = listed ? impl_->list->count_address() : Address<std::uint32_t, shared::TouchedCount>{},
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
    // The new surfel ranges change the gradient rows of the instances. The table of rows
    // keeps its size, because the number of instances does not change.
    impl_->placements = InstanceGradientRows(impl_->layout, n);
    impl_->models.upload(make_models(impl_->layout, impl_->placements));
    impl_->more_rows.upload(impl_->placements.more);
}

void DeviceScene::append_model(Device& device, const DeviceScene& added) {
    Impl& s = *impl_;
    const std::uint32_t first = size(), n = first + added.size();
    if (n > s.parameters.capacity() || n > s.records.size())
        reserve_spare(n, [&](std::size_t capacity) { reserve(device, std::uint32_t(capacity)); });
    // Allocates before it changes the layout, because memory may be exhausted.
    Scene layout = s.layout;
    layout.models.push_back(added.layout().models.front());
    layout.models.back().first = first;
    InstanceGradientRows rows(layout, n);
    Array<shared::ModelEntry> models(device, make_models(layout, rows), "model table");
    Array<std::uint32_t, shared::FurtherRows> more_rows(device, rows.more,
                                                        "gradient rows of further instances");
    s.parameters.upload_at(first, added.surfel_parameters().download());
    s.records.upload(added.surfel_records().download(added.size()), first);
    s.parameters.n = n;
    s.layout = std::move(layout);
    s.placements = std::move(rows);
    s.models = std::move(models);
    s.more_rows = std::move(more_rows);
}

void DeviceScene::append_instance(Device& device, const ModelInstance& instance) {
    Impl& s = *impl_;
    const std::size_t n = s.layout.instances.size() + 1;
    if (n > s.instances.size())
        reserve_spare(n, [&](std::size_t capacity) {
            s.instances = Array<shared::InstanceEntry>(device, capacity, "instance table");
        });
    s.layout.instances.push_back(instance);
    // The instance stays absent until its pose is set.
    s.poses.push_back({.present = false});
    s.placements = InstanceGradientRows(s.layout, size());
    s.models.upload(make_models(s.layout, s.placements));
    s.more_rows = {device, s.placements.more, "gradient rows of further instances"};
    s.instances.upload(s.make_instances(std::vector<InstancePose>(s.poses)));
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
    return impl_->placements.first_row[instance_index];
}
std::uint32_t DeviceScene::count_rows() const { return impl_->placements.n_rows; }

struct TouchedSurfelList::Impl {
    Device& device;
    Array<std::uint32_t, shared::TouchedRows> rows;
    Array<std::uint32_t, shared::TouchedCount> count;
    Kernel<shared::ListTouchedParams> kernel;
};

TouchedSurfelList::TouchedSurfelList(Device& device)
    : impl_(new Impl{device,
                     {},
                     {device, 1, "number of rows with a gradient"},
                     {device, "scene/list_touched", {{SpecialisationConstantId::WORKGROUP_SIZE, 128u}}}}) {}
TouchedSurfelList::~TouchedSurfelList() = default;

void TouchedSurfelList::compact(Stream& stream, Address<std::uint32_t, shared::TouchedSurfels> touched,
                                std::uint32_t n) {
    Impl& l = *impl_;
    if (l.rows.size() < n) {
        stream.submit_and_wait();  // earlier submissions may still use the old array
        l.rows.reserve(l.device, n, "rows with a gradient");
    }
    // resets the counter to 0
    stream.fill(l.count);
    // Each thread checks RELIDAR_LIST_STRETCH rows.
    run(stream, l.kernel, (n + RELIDAR_LIST_STRETCH - 1) / RELIDAR_LIST_STRETCH,
        {.touched = touched, .rows = l.rows.address(), .count = l.count.address(), .n_rows = n});
}

Address<std::uint32_t, shared::TouchedRows> TouchedSurfelList::rows_address() const {
    return impl_->rows.address();
}
Address<std::uint32_t, shared::TouchedCount> TouchedSurfelList::count_address() const {
    return impl_->count.address();
}

std::size_t TouchedSurfelList::choose_threads(std::size_t max_touched_rows) const {
    const bool is_cpu = !should_coalesce(impl_->device);
    return std::min(max_touched_rows, is_cpu ? std::size_t(1) << 12 : std::size_t(1) << 17);
}

}  // namespace relidar
