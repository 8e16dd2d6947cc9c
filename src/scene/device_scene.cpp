// SPDX-License-Identifier: Apache-2.0
// The scene on the device: parameter arrays, records, the instance table, and the activation kernels between them.
#include <relidar/stages/scene.hpp>

#include <algorithm>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "shared/scene.h"

namespace relidar {

static_assert(sizeof(shared::SurfelRecord) == 64 && sizeof(shared::InstanceEntry) == 64);
static_assert(RELIDAR_SH_COEFFICIENTS == kShCoefficients && RELIDAR_SH_FLOATS == kShFloats);

SurfelArrays::SurfelArrays(Device& device, std::uint32_t count, const std::string& what, Primitive kind)
    : mean(device, 3 * std::size_t(count), what + " mean"),
      rotation(device, 4 * std::size_t(count), what + " rotation"),
      log_scale(device, 2 * std::size_t(count), what + " log_scale"),
      opacity_logit(device, count, what + " opacity"),
      sh(device, kShFloats * std::size_t(count), what + " sh"),
      n(count),
      primitive(kind) {
    if (kind == Primitive::gaussian) log_scale_w = Array<float>(device, count, what + " log_scale_w");
}

void SurfelArrays::upload(const Surfels& s) {
    s.check_shapes();
    if (s.size() > 0 && s.primitive() != primitive) throw DataError("uploading surfels: found another primitive than the arrays are for, expected the same");
    mean.upload({&s.mean.data()->x, 3 * s.size()});
    rotation.upload({&s.rotation.data()->x, 4 * s.size()});
    log_scale.upload({&s.log_scale.data()->x, 2 * s.size()});
    opacity_logit.upload(s.opacity_logit);
    sh.upload(s.sh);
    if (primitive == Primitive::gaussian) log_scale_w.upload(s.log_scale_w);
}

std::uint32_t SurfelArrays::capacity() const {
    const std::size_t of_all = std::min({mean.size() / 3, rotation.size() / 4, log_scale.size() / 2, opacity_logit.size(), sh.size() / kShFloats});
    return static_cast<std::uint32_t>(primitive == Primitive::gaussian ? std::min(of_all, log_scale_w.size()) : of_all);
}

void SurfelArrays::reserve(Device& device, std::uint32_t count, const std::string& what) {
    mean.reserve(device, 3 * std::size_t(count), what + " mean");
    rotation.reserve(device, 4 * std::size_t(count), what + " rotation");
    log_scale.reserve(device, 2 * std::size_t(count), what + " log_scale");
    opacity_logit.reserve(device, count, what + " opacity");
    sh.reserve(device, kShFloats * std::size_t(count), what + " sh");
    if (primitive == Primitive::gaussian) log_scale_w.reserve(device, count, what + " log_scale_w");
}

Surfels SurfelArrays::download() const {
    Surfels s;
    s.resize(n, primitive);
    if (n == 0) return s;
    mean.buffer().download(s.mean.data(), s.mean.size() * sizeof(glm::vec3));
    rotation.buffer().download(s.rotation.data(), s.rotation.size() * sizeof(glm::vec4));
    log_scale.buffer().download(s.log_scale.data(), s.log_scale.size() * sizeof(glm::vec2));
    s.opacity_logit = opacity_logit.download(n);
    s.sh = sh.download(kShFloats * std::size_t(n));
    if (primitive == Primitive::gaussian) s.log_scale_w = log_scale_w.download(n);
    return s;
}

void SurfelArrays::fill_zero(Stream& stream) {
    for (Array<float>* array : {&mean, &rotation, &log_scale, &opacity_logit, &sh}) stream.fill(*array);
    if (primitive == Primitive::gaussian) stream.fill(log_scale_w);
}

namespace {

shared::SurfelPointers pointers(const SurfelArrays& arrays) {
    return {arrays.mean.address(), arrays.rotation.address(), arrays.log_scale.address(), arrays.opacity_logit.address(), arrays.sh.address(), arrays.log_scale_w.address()};
}

void check_primitive(Primitive found, const ImageModel& model) {
    if (found == model.primitive) return;
    const bool is_gaussian = found == Primitive::gaussian;
    throw UsageError(fmt::format("image.primitive={}: the scene is made of {}, expected {}: a scene keeps the primitive it was trained with", is_gaussian ? "surfel" : "gaussian",
                                 is_gaussian ? "3D Gaussians" : "surfels", is_gaussian ? "image.primitive=gaussian" : "image.primitive=surfel"));
}

void check_layout(const Scene& scene) {
    for (const Model& model : scene.models)
        if (std::size_t(model.first) + model.count > scene.surfels.size())
            throw DataError(fmt::format("loading scene: model {} ends at surfel {}, expected at most {}", model.name, model.first + model.count, scene.surfels.size()));
    for (const Instance& instance : scene.instances)
        if (instance.model >= scene.models.size())
            throw DataError(fmt::format("loading scene: an instance places model {}, expected one of {}", instance.model, scene.models.size()));
}

std::vector<Constant> activation_constants(bool stage_harmonics) {
    std::vector<Constant> all{{ConstantId::STAGED, stage_harmonics ? 1u : 0u}};
    if (stage_harmonics) all.push_back({ConstantId::WORKGROUP_SIZE, 64u});   // threads that share 4.4 kB: one wave, or two
    return all;
}

/// Where the record gradients of each placement lie: those of a model's first placement are its surfels' own rows, further ones follow
/// after all surfels.
struct GradientRows {
    std::vector<std::uint32_t> first;           ///< [instances]
    std::vector<std::uint32_t> more;            ///< further placements, by model
    std::vector<std::uint32_t> first_of_model;  ///< [models + 1] into `more`
    std::uint32_t n = 0;

    GradientRows(const Scene& scene, std::uint32_t n_surfels) : first(scene.instances.size()), n(n_surfels) {
        for (std::uint32_t model = 0; model < scene.models.size(); ++model) {
            first_of_model.push_back(static_cast<std::uint32_t>(more.size()));
            bool placed = false;
            for (std::size_t i = 0; i < scene.instances.size(); ++i) {
                if (scene.instances[i].model != model) continue;
                first[i] = placed ? n : scene.models[model].first;
                if (placed) more.push_back(n), n += scene.models[model].count;
                placed = true;
            }
        }
        first_of_model.push_back(static_cast<std::uint32_t>(more.size()));
    }
};

}  // namespace

struct DeviceScene::Impl {
    Scene layout;
    GradientRows rows;
    Array<std::uint32_t> more_rows;
    SurfelArrays parameters;
    Array<shared::SurfelRecord> records;
    Array<shared::InstanceEntry> instances;
    std::vector<InstancePose> poses;
    float alpha_min = ImageModel{}.alpha_min;
    Kernel<shared::ActivateParams> activate;
    Kernel<shared::ActivateVjpParams> activate_vjp;

    Impl(Device& device, const Scene& scene, bool stage_harmonics)
        : layout(layout_of(scene)),
          rows(scene, static_cast<std::uint32_t>(scene.surfels.size())),
          more_rows(device, rows.more, "rows of further placements"),
          parameters(device, static_cast<std::uint32_t>(scene.surfels.size()), "surfel", scene.surfels.primitive()),
          records(device, scene.surfels.size(), "surfel records"),
          instances(device, scene.instances.size(), "instance table"),
          activate(device, "scene/activate", activation_constants(stage_harmonics)),
          activate_vjp(device, "scene/activate_vjp", activation_constants(stage_harmonics)) {}

    /// Takes the poses. @return the table hits are moved into their models with; an absent instance has no surfels
    std::vector<shared::InstanceEntry> instance_table(const std::vector<InstancePose>& placed) {
        if (placed.size() != layout.instances.size())
            throw DataError(fmt::format("placing instances: found {} poses, expected {}", placed.size(), layout.instances.size()));
        poses = placed;
        std::vector<shared::InstanceEntry> entries;
        for (std::size_t i = 0; i < placed.size(); ++i) {
            const glm::mat4 m(to_matrix(inverse(placed[i].world_from_model)));
            const Model& model = layout.models[layout.instances[i].model];
            entries.push_back({{m[0].x, m[1].x, m[2].x, m[3].x}, {m[0].y, m[1].y, m[2].y, m[3].y}, {m[0].z, m[1].z, m[2].z, m[3].z}, model.first, placed[i].present ? model.count : 0u, rows.first[i], 0});
        }
        return entries;
    }

    /// View origin in the frame of a model, as its first instance sees it.
    glm::vec3 view_origin(std::size_t model, const glm::vec3& world) const {
        for (std::size_t i = 0; i < layout.instances.size(); ++i)
            if (layout.instances[i].model == model) return glm::vec3(inverse(poses[i].world_from_model) * glm::dvec3(world));
        return world;
    }
};

DeviceScene::DeviceScene(Device& device, const Scene& scene, std::optional<bool> stage_harmonics) {
    check_layout(scene);
    impl_ = std::make_unique<Impl>(device, scene, stage_harmonics.value_or(coalesces(device)));
    impl_->parameters.upload(scene.surfels);
    set_poses(std::vector<Pose>(scene.instances.size()));
}

DeviceScene::~DeviceScene() = default;

void DeviceScene::set_poses(const std::vector<Pose>& world_from_instance) {
    std::vector<InstancePose> placed;
    for (const Pose& pose : world_from_instance) placed.push_back({pose});
    impl_->instances.upload(impl_->instance_table(placed));
}

void DeviceScene::place(Stream& stream, const std::vector<InstancePose>& placed) {
    const std::vector<shared::InstanceEntry> entries = impl_->instance_table(placed);
    impl_of(stream).write(impl_->instances.buffer(), entries.data(), entries.size() * sizeof(entries[0]));
}

void DeviceScene::activate(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m) {
    if (size() > 0) check_primitive(primitive(), model);
    impl_->alpha_min = model.alpha_min;
    for (std::size_t i = 0; i < impl_->layout.models.size(); ++i) {
        const Model& range = impl_->layout.models[i];
        run(stream, impl_->activate, range.count,
            {.surfels = pointers(impl_->parameters),
             .records = impl_->records.address(),
             .view_origin = impl_->view_origin(i, view_origin_m),
             .alpha_min = model.alpha_min,
             .first_surfel = range.first,
             .n_surfels = range.count,
             .sh_degree = static_cast<std::uint32_t>(model.sh_degree),
             .sh_per_surfel = model.sh_direction == ShDirection::surfel ? 1u : 0u});
    }
}

void DeviceScene::activate_vjp(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m, const ActivationGradients& g) {
    const GradientRows& rows = impl_->rows;
    for (std::size_t i = 0; i < impl_->layout.models.size(); ++i) {
        const Model& range = impl_->layout.models[i];
        run(stream, impl_->activate_vjp, range.count,
            {.surfels = pointers(impl_->parameters),
             .d_records = g.d_records->address(),
             .more_rows = impl_->more_rows.address(rows.first_of_model[i]),
             .d_surfels = pointers(*g.d_surfels),
             .touched = g.touched->address(),
             .d_view = address_of(g.d_view),
             .view_origin = impl_->view_origin(i, view_origin_m),
             .first_surfel = range.first,
             .n_surfels = range.count,
             .n_more = rows.first_of_model[i + 1] - rows.first_of_model[i],
             .sh_degree = static_cast<std::uint32_t>(model.sh_degree),
             .sh_per_surfel = model.sh_direction == ShDirection::surfel ? 1u : 0u,
             .zero_untouched = g.zero_untouched ? 1u : 0u});
    }
}

void DeviceScene::reserve(Device& device, std::uint32_t capacity) {
    impl_->parameters.reserve(device, capacity, "surfel");
    impl_->records.reserve(device, capacity, "surfel records");
}

void DeviceScene::set_models(const std::vector<Model>& models) {
    const std::uint32_t n = models.empty() ? 0u : models.back().first + models.back().count;
    RELIDAR_ASSERT_LE(n, impl_->parameters.capacity());
    RELIDAR_ASSERT_LE(std::size_t(n), impl_->records.size());
    impl_->layout.models = models;
    impl_->parameters.n = n;
    impl_->rows = GradientRows(impl_->layout, n);
    impl_->more_rows.upload(impl_->rows.more);   // as many as before: instances do not change
}

const std::vector<InstancePose>& DeviceScene::poses() const { return impl_->poses; }
const Scene& DeviceScene::layout() const { return impl_->layout; }
SurfelArrays& DeviceScene::parameters() { return impl_->parameters; }
const SurfelArrays& DeviceScene::parameters() const { return impl_->parameters; }
const Array<shared::SurfelRecord>& DeviceScene::records() const { return impl_->records; }
const Array<shared::InstanceEntry>& DeviceScene::instances() const { return impl_->instances; }
float DeviceScene::alpha_min() const { return impl_->alpha_min; }
Primitive DeviceScene::primitive() const { return impl_->parameters.primitive; }
std::uint32_t DeviceScene::size() const { return impl_->parameters.n; }
std::uint32_t DeviceScene::first_gradient_row(std::size_t instance) const { return impl_->rows.first[instance]; }
std::uint32_t DeviceScene::gradient_rows() const { return impl_->rows.n; }

}  // namespace relidar
