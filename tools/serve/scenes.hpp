// SPDX-License-Identifier: Apache-2.0
// Manages the runs of the server. The data of each run without its surfels stays in
// memory. The surfels of recently used runs stay on the device.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "scene_source.hpp"
#include "spawned.hpp"

namespace relidar::serve {

/// All scenes of one device. Only the thread of the device may use this class. Exceptions
/// are outlines(), assets() and spawned(), which any thread may call.
class SceneSet {
public:
    /// Loads each run once to check it and to measure its size.
    /// @param memory_bytes device memory for all scenes together. If the scenes need more
    /// memory, the least recently used scene is unloaded.
    /// @param assets assets that can be spawned; must outlive this object
    /// @throws DataError if a run cannot be read, or if a single run needs more than this
    /// memory
    SceneSet(Device& device, std::vector<SceneSource> sources, std::uint64_t memory_bytes,
             const AssetCatalogue& assets);

    /// Returns all runs without their surfels and ray-drop networks, in the order in
    /// which the runs were given. The result never changes.
    const std::vector<Run>& outlines() const { return outlines_; }
    const std::vector<SceneSource>& sources() const { return sources_; }
    const AssetCatalogue& assets() const { return assets_; }
    SpawnedActors& spawned() { return spawned_; }

    /// Spawns actors in a scene. If the scene has no free slots for the actors, it is
    /// loaded again with more slots.
    /// @return the slots in the order of the requests
    /// @throws Refusal if a name is in use, if an asset does not fit, or if the device
    /// memory is too small. The scene is then unchanged.
    std::vector<SpawnedActors::Place> spawn(std::size_t scene, const std::vector<ActorToSpawn>& wishes);

    /// Counts how often a scene was loaded. Scans that were requested before a scene was
    /// loaded again are lost, so the number shows whether a scan is still pending.
    enum class Load : std::uint64_t {};
    /// Calls a function with the renderer of a scene. Loads the scene first if necessary.
    /// @param scene index into outlines()
    /// @param weather weather to simulate; without a value, the weather of the scene's
    /// source
    Load use(std::size_t scene, const std::optional<Weather>& weather,
             const std::function<void(ScanRenderer&)>& work);
    /// Calls a second function that reads the results of an earlier use(). Must be called
    /// before another scene is used.
    /// @throws DeviceError if the device was lost or the scene was loaded again
    void reuse_scene(std::size_t scene, Load load, const std::function<void(ScanRenderer&)>& work);

    /// Returns true if the surfels of the scene are on the device.
    bool is_loaded(std::size_t scene) const { return loaded_[scene].renderer != nullptr; }

private:
    struct Loaded {
        /// Renderer of the scene. It is null if the scene is not loaded.
        std::unique_ptr<ScanRenderer> renderer;
        std::uint64_t bytes = 0;  ///< Device memory that the most recently loaded renderer uses.
        /// Counter value of the last use. It shows which scene was used least recently.
        std::uint64_t used = 0;
        Load load{};               ///< Number that identifies the most recent load of the scene.
        std::size_t n_places = 0;  ///< Number of slots for spawned actors in the loaded scene.
    };

    Device& device_;
    const std::vector<SceneSource> sources_;
    const std::uint64_t memory_bytes_;
    std::vector<Run> outlines_;
    std::vector<Loaded> loaded_;
    const AssetCatalogue& assets_;
    SpawnedActors spawned_;
    std::uint64_t clock_ = 0;

    void load(std::size_t scene, const Run& run);
    void load_with_places(std::size_t scene);
    void make_room(std::size_t scene, std::uint64_t bytes);
    void count_growth(std::size_t scene, const std::function<void()>& work);
    void attempt(std::size_t scene, const std::function<void(ScanRenderer&)>& work);
};

}  // namespace relidar::serve
