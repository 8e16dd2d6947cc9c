// SPDX-License-Identifier: Apache-2.0
#include "spawned.hpp"

#include <algorithm>

#include "base/fail.hpp"

#include "asset_catalogue.hpp"
#include "refusal.hpp"

namespace relidar::serve {
namespace {

// With image.sh_direction=surfel, even an unused slot needs a copy of the surfels.
constexpr std::size_t kMaxAddedSlots = 8;

using SpawnedActorSlots = std::vector<ActorToSpawn>;

auto find_slot(SpawnedActorSlots& slots, const std::string& actor_name) {
    return std::ranges::find(slots, actor_name, &ActorToSpawn::name);
}

/// Returns the index of a free slot for the same model. If there is none, adds as many
/// slots as the model already has, so that a growing scene is seldom loaded again.
std::size_t free_slot(SpawnedActorSlots& slots, const ActorToSpawn& actor) {
    const auto is_free = [&](const ActorToSpawn& p) { return p.name.empty() && p.source == actor.source; };
    const auto free = std::ranges::find_if(slots, is_free);
    if (free != slots.end()) return std::size_t(free - slots.begin());
    const auto of_source = std::size_t(std::ranges::count(slots, actor.source, &ActorToSpawn::source));
    if (slots.size() >= SpawnedActorRegistry::kMaxSlots)
        refuse(Code::RESOURCE_EXHAUSTED,
               "cannot spawn {}: this scene already has {} spawned actors, which is the maximum",
               quote_client_text(actor.name), slots.size());
    const std::size_t first = slots.size();
    ActorToSpawn empty = actor;
    empty.name.clear();
    slots.resize(std::min(first + std::clamp<std::size_t>(of_source, 1, kMaxAddedSlots),
                          SpawnedActorRegistry::kMaxSlots),
                 empty);
    return first;
}

std::uint32_t model_of(const Scene& scene, const std::string& track_name) {
    const auto instance = std::ranges::find(scene.instances, track_name, &ModelInstance::track);
    if (instance == scene.instances.end())
        fail("cannot spawn {}: the run no longer has this actor", track_name);
    return instance->model;
}

}  // namespace

std::vector<SpawnSlot> SpawnedActorRegistry::list_all_slots(std::size_t scene) const {
    const std::lock_guard lock(mutex_);
    std::vector<SpawnSlot> all;
    for (const ActorToSpawn& actor : scenes_[scene]) all.push_back({all.size(), actor});
    return all;
}

std::vector<SpawnSlot> SpawnedActorRegistry::list_occupied(std::size_t scene) const {
    std::vector<SpawnSlot> all = list_all_slots(scene);
    std::erase_if(all, [](const SpawnSlot& place) { return place.actor.name.empty(); });
    return all;
}

std::size_t SpawnedActorRegistry::slot_count(std::size_t scene) const {
    const std::lock_guard lock(mutex_);
    return scenes_[scene].size();
}

std::vector<SpawnSlot> SpawnedActorRegistry::assign_slots(std::size_t scene,
                                                          const std::vector<ActorToSpawn>& actors) {
    const std::lock_guard lock(mutex_);
    // Changes a copy of the slots, so that a rejected request has no effect.
    SpawnedActorSlots slots = scenes_[scene];
    std::vector<SpawnSlot> occupied_slots;
    for (const ActorToSpawn& wish : actors) {
        if (find_slot(slots, wish.name) != slots.end())
            refuse(Code::ALREADY_EXISTS, "cannot spawn {}: an actor with this name exists; use another name",
                   quote_client_text(wish.name));
        const std::size_t position = free_slot(slots, wish);
        slots[position] = wish;
        occupied_slots.push_back({position, wish});
    }
    scenes_[scene] = std::move(slots);
    return occupied_slots;
}

void SpawnedActorRegistry::remove_actors(std::size_t scene, const std::vector<std::string>& names) {
    const std::lock_guard lock(mutex_);
    SpawnedActorSlots slots = scenes_[scene];
    for (const std::string& name : names) {
        const auto slot = find_slot(slots, name);
        if (name.empty() || slot == slots.end())
            refuse(Code::NOT_FOUND,
                   "cannot despawn {}: no spawned actor has this name, or the request names it twice",
                   quote_client_text(name));
        slot->name.clear();
    }
    scenes_[scene] = std::move(slots);
}

void SpawnedActorRegistry::undo_assign(std::size_t scene, const std::vector<SpawnSlot>& slots,
                                       std::size_t n_before) {
    const std::lock_guard lock(mutex_);
    for (const SpawnSlot& slot : slots) scenes_[scene][slot.position].name.clear();
    scenes_[scene].resize(n_before);
}

/// Returns a track name for the actor in a slot. The control character at its start keeps
/// it different from all track names of the run.
std::string slot_track_name(std::size_t slot_index) { return fmt::format("\x01spawned {}", slot_index); }

/// Adds an actor instance for each slot to the run. Slots with the same asset share one
/// surfel model.
void add_spawned(Run& run, const std::vector<SpawnSlot>& slots, const AssetCatalogue& assets) {
    std::map<std::string, std::uint32_t> models;  // Index of the surfel model of each asset.
    for (const SpawnSlot& slot : slots) {
        const SpawnedModelSource& source = slot.actor.source;
        std::uint32_t model = 0;
        if (!source.is_asset) model = model_of(run.scene, source.name);
        else if (const auto model_entry = models.find(source.name); model_entry != models.end())
            model = model_entry->second;
        else {
            const AssetCatalogue::CatalogueEntry& asset = *assets.find_asset(source.name);
            const Run asset_run = load_run(asset.folder);
            model = models[source.name] =
                append_model(run.scene, asset_run.scene, model_of(asset_run.scene, only_track(asset_run)));
            // The output channel "class" reads the kind of the actor from its box.
            run.sequence.boxes.push_back({.id = run.scene.models[model].name,
                                          .category = name_of(asset.facts.kind),
                                          .size_m = asset.facts.size_m,
                                          .world_from_box = {}});
        }
        run.scene.instances.push_back({model, slot_track_name(slot.position)});
    }
}

}  // namespace relidar::serve
