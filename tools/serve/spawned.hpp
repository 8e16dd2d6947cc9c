// SPDX-License-Identifier: Apache-2.0
// Actors that clients have put into scenes. For any thread.
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

/// What is spawned: an actor of the scene's run, or an asset.
struct SpawnSource {
    bool is_asset = false;
    std::string name;

    bool operator==(const SpawnSource&) const = default;
};

/// What a client wants, and gets.
struct SpawnWish {
    std::string name;  ///< the client's own
    SpawnSource source;
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// The places of spawned actors: instances behind those of a scene's run. A place keeps
/// its source for as long as the server lives, and waits for the next actor of that
/// source when its own is gone: what has been read of a request stays right, and a scene
/// need not be loaded anew for each actor.
class SpawnedActors {
public:
    static constexpr std::size_t kMostPlaces = 4096;  ///< of a scene

    explicit SpawnedActors(std::size_t n_scenes) : scenes_(n_scenes) {}

    /// A place, by its position among those of its scene.
    struct Place {
        std::size_t position = 0;
        SpawnWish actor;  ///< name empty: it is free
    };
    std::vector<Place> places(std::size_t scene) const;
    /// Those that are taken.
    std::vector<Place> taken(std::size_t scene) const;

    /// Finds a place for each. Where there is no free one as many more are made as there
    /// are of that source, 8 at most.
    /// @return in the order of the wishes @throws Refusal where a name is taken, or no
    /// more places can be had: then nothing has changed
    std::vector<Place> take(std::size_t scene, const std::vector<SpawnWish>& wishes);
    /// All of them, or none. @throws Refusal for a name that is not there
    void give_back(std::size_t scene, const std::vector<std::string>& names);
    /// Undoes take(): the names are free, and so many places are left.
    void undo(std::size_t scene, const std::vector<Place>& places, std::size_t n_before);
    std::size_t count_places(std::size_t scene) const;

private:
    mutable std::mutex mutex_;
    std::vector<std::vector<SpawnWish>> scenes_;  ///< by position
};

/// The track of a place in the scene that is rendered: no run has such a name.
std::string track_of_place(std::size_t position);

/// Adds an instance for each place to a run that is about to be rendered, and the models
/// of assets, once each.
/// @throws DataError for an asset that cannot be read, or is made of another primitive
/// than the run
void add_places(Run& run, const std::vector<SpawnedActors::Place>& places, const AssetShelf& assets);

}  // namespace relidar::serve
