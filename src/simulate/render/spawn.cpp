// SPDX-License-Identifier: Apache-2.0
// Adds actors to a scene that is being rendered, and removes them. An added instance
// stays in the scene: after despawn(), it is a free slot for the next actor with the same
// model.
#include <relidar/run/run.hpp>
#include <relidar/simulate/assets.hpp>

#include "base/fail.hpp"
#include "base/random.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

/// Returns a hash of everything that a renderer reads from a model.
std::uint64_t hash_model(const Scene& model) {
    const SurfelModel& description = model.models.front();
    std::uint64_t hash = description.count;
    const auto add_floats = [&](std::span<const float> values) {
        const std::string_view bytes(reinterpret_cast<const char*>(values.data()), values.size_bytes());
        hash = hash_pair(hash, std::hash<std::string_view>{}(bytes));
    };
    for (const SurfelParameterGroup& group : list_groups(model.surfels.parameters_used()))
        add_floats(group.values(model.surfels));
    const glm::vec3& half_size_m = description.half_size_m;
    add_floats(std::array{half_size_m.x, half_size_m.y, half_size_m.z, description.stride_m});
    return hash;
}

/// @param box of the actor whose model is used; null if its log has none
SpawnedActor make_spawned(const std::string& name, const BoxTrack* box) {
    if (!box) return {.name = name};
    return {.name = name, .category = box->category, .size_m = box->size_m};
}

}  // namespace

void ScanRenderer::Impl::check_new_name(const std::string& name) const {
    if (name.empty() || name == "background" || name == "actors" || sweeps.has_actor(name))
        fail<UsageError>("cannot spawn an actor: found the name \"{}\", expected one that is not in use",
                         name);
}

/// Adds a model to all copies of the scene.
std::uint32_t ScanRenderer::Impl::add_model(const Scene& model, const BoxTrack& box) {
    // The copies use the stream of the renderer, so they are removed before it.
    if (scene.must_reload(model)) lanes->remove_copies();
    const std::uint32_t index = scene.add_model(model);
    lanes->change_copies([&](Renderer& copy) { copy.append_model(model); });
    sweeps.add_model(model.models.front(), box);
    return index;
}

/// Adds an instance of a model, or of a copy of the model, to all copies of the scene.
/// @param name of the first actor that uses the instance
ActorHandle ScanRenderer::Impl::add_instance(std::uint32_t source, const std::string& name) {
    const Scene& layout = sweeps.layout();
    // Instances cannot share a model whose surfel records depend on the pose of the
    // instance: because of their SH, or because the actor walks.
    const bool can_share =
        config.image.sh_direction == ShDirection::ray && layout.models[source].stride_m <= 0.0f;
    const bool is_used =
        std::ranges::find(layout.instances, source, &ModelInstance::model) != layout.instances.end();
    ModelInstance instance{source, name};
    if (is_used && !can_share) instance.model = add_model(scene.copy_model(source), {});
    scene.add_instance(instance);
    lanes->change_copies([&](Renderer& copy) { copy.append_instance(instance); });
    return ActorHandle(sweeps.add_instance(instance.model));
}

/// Returns the slot of a spawned actor, or null if no spawned actor has this name.
SpawnSlot* ScanRenderer::Impl::find_slot(const std::string& name) {
    const auto slot = std::ranges::find_if(
        slots, [&](const SpawnSlot& one) { return !name.empty() && one.actor.name == name; });
    return slot == slots.end() ? nullptr : &*slot;
}

/// Gives an actor an instance of its model: one that a removed actor has left, which has
/// no name, or a new one.
/// @param source model of the actor
ActorHandle ScanRenderer::Impl::fill_slot(std::uint32_t source, SpawnedActor actor) {
    auto slot = std::ranges::find_if(slots, [&](const SpawnSlot& candidate) {
        return candidate.source == source && candidate.actor.name.empty();
    });
    if (slot == slots.end())
        slot = slots.insert(slot, {source, {.handle = add_instance(source, actor.name)}});
    actor.handle = slot->actor.handle;
    sweeps.name_instance(std::uint32_t(actor.handle), actor.name);
    slot->actor = std::move(actor);
    return slot->actor.handle;
}

ActorHandle ScanRenderer::spawn(const std::string& actor, const std::string& name) {
    Impl& renderer = *impl_;
    renderer.check_new_name(name);
    const std::uint32_t instance = renderer.sweeps.find_actor(actor);  // throws if it is unknown
    renderer.finish_pending();
    // A copy of a spawned actor has the same source model.
    if (const SpawnSlot* original = renderer.find_slot(actor)) {
        SpawnedActor copy = original->actor;
        copy.name = name;
        return renderer.fill_slot(original->source, std::move(copy));
    }
    return renderer.fill_slot(renderer.sweeps.layout().instances[instance].model,
                              make_spawned(name, find_box(renderer.sweeps.log(), actor)));
}

ActorHandle ScanRenderer::spawn(const Run& asset, const std::string& name) {
    Impl& renderer = *impl_;
    renderer.check_new_name(name);
    const std::string track = only_track(asset);
    const auto instance = std::ranges::find(asset.scene.instances, track, &ModelInstance::track);
    Scene model;  // a scene with only the model of the actor
    model.instances = {{.model = 0, .track = track}};
    append_model(model, asset.scene, instance->model);
    SpawnedActor actor = make_spawned(name, find_box(asset.log, track));
    renderer.finish_pending();
    // Equal models are added only once. Their hash identifies them.
    const std::uint64_t hash = hash_model(model);
    auto known = renderer.asset_models.find(hash);
    if (known == renderer.asset_models.end()) {
        // The box has the name of the model, by which the channel "class" finds it.
        std::string& model_name = model.models.front().name;
        model_name = fmt::format("spawned model {}", hash);
        const std::uint32_t added =
            renderer.add_model(model, {.id = model_name, .category = actor.category, .world_from_box = {}});
        known = renderer.asset_models.emplace(hash, added).first;
    }
    return renderer.fill_slot(known->second, std::move(actor));
}

void ScanRenderer::despawn(const std::string& name) {
    SpawnSlot* slot = impl_->find_slot(name);
    if (!slot) fail<UsageError>("cannot despawn \"{}\": no spawned actor has this name", name);
    impl_->sweeps.name_instance(std::uint32_t(slot->actor.handle), "");
    slot->actor.name.clear();
}

std::vector<SpawnedActor> ScanRenderer::spawned() const {
    std::vector<SpawnedActor> actors;
    for (const SpawnSlot& slot : impl_->slots)
        if (!slot.actor.name.empty()) actors.push_back(slot.actor);
    return actors;
}

ActorHandle ScanRenderer::find_actor(const std::string& name) const {
    return ActorHandle(impl_->sweeps.find_actor(name));
}

}  // namespace relidar
