// SPDX-License-Identifier: Apache-2.0
// Stores the actors that clients have spawned in scenes. Any thread may use this class.
#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {
struct Run;
}

namespace relidar::serve {

class AssetCatalogue;

/// Model of a spawned actor. It is either an actor of the scene's run or an asset.
struct SpawnSource {
    bool is_asset = false;
    std::string name;

    bool operator==(const SpawnSource&) const = default;
};

/// Describes an actor that a client wants to spawn.
struct ActorToSpawn {
    std::string name;  ///< Name chosen by the client.
    SpawnSource source;
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// Assigns slots to spawned actors. A slot is an instance of a model in the scene, added
/// after the instances of the run. A slot keeps its model as long as the server runs.
/// After its actor is removed, the next actor of the same model reuses the slot.
/// Therefore a scene need not be loaded again for each actor, and requests that were read
/// earlier stay valid.
class SpawnedActors {
public:
    static constexpr std::size_t kMostPlaces = 4096;  ///< Maximum number of slots per scene.

    explicit SpawnedActors(std::size_t n_scenes) : scenes_(n_scenes) {}

    /// A slot for a spawned actor, and its index in the scene.
    struct Place {
        std::size_t position = 0;
        ActorToSpawn actor;  ///< Actor in this slot. The name is empty if the slot is free.
    };
    std::vector<Place> places(std::size_t scene) const;
    /// Returns the slots that contain an actor.
    std::vector<Place> taken(std::size_t scene) const;

    /// Assigns a slot to each actor. If a model has no free slot, the number of its slots
    /// is doubled, but at most 8 slots are added.
    /// @return the slots in the order of the requests
    /// @throws Refusal if a name is in use or the limit of slots is reached. Nothing is
    /// changed then.
    std::vector<Place> take(std::size_t scene, const std::vector<ActorToSpawn>& wishes);
    /// Releases the slots of all named actors.
    /// @throws Refusal if a name is unknown. No slot is released then.
    void release(std::size_t scene, const std::vector<std::string>& names);
    /// Reverts take(). Releases the names of the actors and removes the slots that take()
    /// has added.
    void undo(std::size_t scene, const std::vector<Place>& places, std::size_t n_before);
    std::size_t count_places(std::size_t scene) const;

private:
    mutable std::mutex mutex_;
    /// Slots of each scene. The first index is the scene, the second index is the slot.
    std::vector<std::vector<ActorToSpawn>> scenes_;
};

/// Returns the track name of a slot in the rendered scene. No track of a run has the same
/// name.
std::string track_of_slot(std::size_t position);

/// Adds an instance to the run for each slot. Adds the model of each asset once. Must be
/// called before the run is rendered.
/// @throws DataError if an asset cannot be read, or if its surfels have another primitive
/// shape than those of the run
void add_places(Run& run, const std::vector<SpawnedActors::Place>& places, const AssetCatalogue& assets);

}  // namespace relidar::serve
