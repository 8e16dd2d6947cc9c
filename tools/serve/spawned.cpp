// SPDX-License-Identifier: Apache-2.0
#include "spawned.hpp"

#include <algorithm>

#include <relidar/simulate/render.hpp>

#include "asset_catalogue.hpp"
#include "refusal.hpp"

namespace relidar::serve {
namespace {

using SpawnedActorSlots = std::vector<ActorToSpawn>;

auto find_slot(SpawnedActorSlots& slots, const std::string& actor_name) {
    return std::ranges::find(slots, actor_name, &ActorToSpawn::name);
}

/// Returns the index of a slot for the same model that is free: its actor has no name.
/// Adds a slot if there is none.
std::size_t free_slot(SpawnedActorSlots& slots, const ActorToSpawn& actor) {
    const auto is_free = [&](const ActorToSpawn& p) { return p.name.empty() && p.source == actor.source; };
    const auto found = std::ranges::find_if(slots, is_free);
    if (found != slots.end()) return std::size_t(found - slots.begin());
    if (slots.size() >= SpawnedActorRegistry::kMaxSlots)
        refuse(Code::RESOURCE_EXHAUSTED,
               "cannot spawn {}: this scene already has {} spawned actors, which is the maximum",
               quote_client_text(actor.name), slots.size());
    slots.emplace_back();
    return slots.size() - 1;
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

std::vector<SpawnSlot> SpawnedActorRegistry::assign_slots(std::size_t scene,
                                                          const std::vector<ActorToSpawn>& actors) {
    const std::lock_guard lock(mutex_);
    // Changes a copy of the slots, so that a rejected request has no effect.
    SpawnedActorSlots slots = scenes_[scene];
    std::vector<SpawnSlot> occupied_slots;
    for (const ActorToSpawn& actor : actors) {
        if (find_slot(slots, actor.name) != slots.end())
            refuse(Code::ALREADY_EXISTS, "cannot spawn {}: an actor with this name exists; use another name",
                   quote_client_text(actor.name));
        const std::size_t position = free_slot(slots, actor);
        slots[position] = actor;
        occupied_slots.push_back({position, actor});
    }
    scenes_[scene] = std::move(slots);
    return occupied_slots;
}

/// Frees the slots of actors, which remain for later actors with the same model.
void SpawnedActorRegistry::remove_actors(std::size_t scene, const std::vector<std::string>& names) {
    const std::lock_guard lock(mutex_);
    // Changes a copy, so that a rejected request has no effect.
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

/// Adds an actor to the renderer for each slot from index `first` on. It is a copy of an
/// actor of the run, or of an asset. If an earlier slot has the same asset, copies the
/// actor of that slot, so that each asset is read only once.
void spawn_slots(ScanRenderer& renderer, const std::vector<SpawnSlot>& slots, std::size_t first,
                 const AssetCatalogue& assets) {
    for (std::size_t i = first; i < slots.size(); ++i) {
        const SpawnedModelSource& source = slots[i].actor.source;
        const std::string track = slot_track_name(slots[i].position);
        if (!source.is_asset) {
            renderer.spawn(source.name, track);
            continue;
        }
        // Finds slot i itself if no earlier slot has this asset.
        const auto first_with_asset =
            std::ranges::find_if(slots, [&](const SpawnSlot& slot) { return slot.actor.source == source; });
        const bool is_first = first_with_asset == slots.begin() + std::ptrdiff_t(i);
        if (!is_first) {
            renderer.spawn(slot_track_name(first_with_asset->position), track);
        } else {
            const AssetCatalogue::CatalogueEntry& asset = *assets.find_asset(source.name);
            Run run = load_run(asset.folder);
            // The output channel "class" reads the kind of the actor from its box.
            for (BoxTrack& box : run.log.boxes) box.category = name_of(asset.facts.kind);
            renderer.spawn(run, track);
        }
    }
}

}  // namespace relidar::serve
