// SPDX-License-Identifier: Apache-2.0
// Actors that clients have spawned in scenes. May be used from any thread.
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

class AssetShelf;

/// Source of a spawned actor: an actor of the scene's run, or an asset.
struct SpawnSource {
    bool is_asset = false;
    std::string name;

    bool operator==(const SpawnSource&) const = default;
};

/// An actor to spawn.
struct SpawnWish {
    std::string name;  ///< Name chosen by the client.
    SpawnSource source;
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// Places of spawned actors: instances that follow those of the scene's run. A place
/// keeps its source during the lifetime of the server and is reused for the next actor of
/// this source. Requests that were already read therefore stay valid, and a scene need
/// not be loaded again for each actor.
class SpawnedActors {
public:
    static constexpr std::size_t kMostPlaces = 4096;  ///< Maximum number of places per scene.

    explicit SpawnedActors(std::size_t n_scenes) : scenes_(n_scenes) {}

    /// A place and its index in the scene.
    struct Place {
        std::size_t position = 0;
        SpawnWish actor;  ///< An empty name marks a free place.
    };
    std::vector<Place> places(std::size_t scene) const;
    /// Returns the places in use.
    std::vector<Place> taken(std::size_t scene) const;

    /// Assigns a place to each actor. If no place of its source is free, the number of
    /// its places is doubled, but at most 8 places are added.
    /// @return places in the order of the requests
    /// @throws Refusal if a name is in use or the limit of places is reached; nothing is
    /// changed then
    std::vector<Place> take(std::size_t scene, const std::vector<SpawnWish>& wishes);
    /// Releases the places of all named actors.
    /// @throws Refusal for an unknown name; no place is released then
    void give_back(std::size_t scene, const std::vector<std::string>& names);
    /// Reverts take(): frees the names and restores the previous number of places.
    void undo(std::size_t scene, const std::vector<Place>& places, std::size_t n_before);
    std::size_t count_places(std::size_t scene) const;

private:
    mutable std::mutex mutex_;
    std::vector<std::vector<SpawnWish>> scenes_;  ///< Places of each scene, indexed by scene and place.
};

/// Returns the track of a place in the rendered scene. No track of a run has such a name.
std::string track_of_place(std::size_t position);

/// Adds an instance for each place to a run before it is rendered, and the model of each
/// asset once.
/// @throws DataError if an asset cannot be read, or its primitive differs from that of
/// the run
void add_places(Run& run, const std::vector<SpawnedActors::Place>& places, const AssetShelf& assets);

}  // namespace relidar::serve
