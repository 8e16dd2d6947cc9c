// SPDX-License-Identifier: Apache-2.0
// Stores the actors that clients have added ("spawned") to scenes.
#pragma once

#include <mutex>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {
class ScanRenderer;
}

namespace relidar::serve {

class AssetCatalogue;

struct SpawnedModelSource {
    bool is_asset = false;
    std::string name;

    bool operator==(const SpawnedModelSource&) const = default;
};

struct ActorToSpawn {
    std::string name;  ///< Name chosen by the client.
    SpawnedModelSource source;
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// `position` is the index of the slot in the scene.
struct SpawnSlot {
    std::size_t position = 0;
    ActorToSpawn actor;  ///< Actor in this slot. The name is empty if the slot is free.
};

/// A slot is an additional instance of a model in the scene, which the next actor with
/// the same model reuses. Thread-safe.
class SpawnedActorRegistry {
public:
    static constexpr std::size_t kMaxSlots = 4096;  ///< Maximum number of slots per scene.

    explicit SpawnedActorRegistry(std::size_t n_scenes) : scenes_(n_scenes) {}

    std::vector<SpawnSlot> list_all_slots(std::size_t scene) const;
    std::vector<SpawnSlot> list_occupied(std::size_t scene) const;

    /// Assigns a slot to each actor. Adds a slot if all slots of its model are occupied.
    /// @return the slots in the order of `actors`
    /// @throws RejectedRequest if a name is in use or there are too many slots; nothing
    /// changes
    std::vector<SpawnSlot> assign_slots(std::size_t scene, const std::vector<ActorToSpawn>& actors);
    void remove_actors(std::size_t scene, const std::vector<std::string>& names);
    void undo_assign(std::size_t scene, const std::vector<SpawnSlot>& slots, std::size_t n_before);

private:
    mutable std::mutex mutex_;
    /// [scenes][slots] actor in each slot of each scene
    std::vector<std::vector<ActorToSpawn>> scenes_;
};

std::string slot_track_name(std::size_t slot_index);

/// @param slots  all slots of the scene
/// @throws DataError if an asset cannot be read, or if its type of Gaussians differs from
/// the run
void spawn_slots(ScanRenderer& renderer, const std::vector<SpawnSlot>& slots, std::size_t first,
                 const AssetCatalogue& assets);

}  // namespace relidar::serve
