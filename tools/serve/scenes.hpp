// SPDX-License-Identifier: Apache-2.0
// Manages the runs of the server. Their surfels are on the device only if the run was
// used recently. All other data of the runs stay in host memory.
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

/// All scenes of one device. Only the render thread may use this class, except for
/// outlines(), assets() and spawned().
class SceneSet {
public:
    /// Loads each run once to check it and to measure its size on the device.
    /// @param memory_bytes device memory for all scenes together; if it is exceeded, the
    /// least recently used scene is unloaded
    /// @param assets assets that clients can add; must outlive this object
    /// @throws DataError if a run cannot be read, or if a single run needs more memory
    SceneSet(Device& device, std::vector<SceneSource> sources, std::uint64_t memory_bytes,
             const AssetCatalogue& assets);

    /// Returns all runs without their surfels and ray-drop networks, in the order of the
    /// constructor's argument. The result never changes.
    const std::vector<Run>& outlines() const { return outlines_; }
    const std::vector<SceneSource>& sources() const { return sources_; }
    const AssetCatalogue& assets() const { return assets_; }
    SpawnedActors& spawned() { return spawned_; }

    /// Adds actors to a scene. If the scene has too few free slots, it is loaded again
    /// with more slots.
    /// @return the slots of the actors, in the order of the requests
    /// @throws Refusal if a name is in use, if an asset does not fit, or if the device
    /// memory is too small; the scene is then unchanged
    std::vector<SpawnedActors::Place> spawn(std::size_t scene, const std::vector<ActorToSpawn>& actors);

    /// Number that changes each time a scene is loaded. Loading discards pending scans,
    /// so a changed number shows that a scan is lost.
    enum class Load : std::uint64_t {};
    /// Calls a function with the renderer of a scene. First loads the scene if it is not
    /// on the device.
    /// @param scene index into outlines()
    /// @param weather weather to simulate; without a value, the weather of the scene's
    /// source
    /// @return number of the current load, for call_with_loaded_scene()
    Load use(std::size_t scene, const std::optional<Weather>& weather,
             const std::function<void(ScanRenderer&)>& work);
    /// Calls a function that reads the results of an earlier use(). Must be called before
    /// another scene is used.
    /// @param load the number that use() returned
    /// @throws DeviceError if the device was lost or the scene was loaded again
    void call_with_loaded_scene(std::size_t scene, Load load, const std::function<void(ScanRenderer&)>& work);

    /// Returns true if the surfels of the scene are on the device.
    bool is_loaded(std::size_t scene) const { return loaded_[scene].renderer != nullptr; }

private:
    struct Loaded {
        /// Renderer of the scene. The pointer is null if the scene is not on the device.
        std::unique_ptr<ScanRenderer> renderer;
        /// Device memory of the renderer in bytes. Keeps the last value after the scene
        /// is unloaded.
        std::uint64_t bytes = 0;
        /// counter value of the last use; the scene with the smallest value was used
        /// least recently
        std::uint64_t used = 0;
        Load load{};               ///< Number of the most recent load of the scene.
        std::size_t n_places = 0;  ///< Number of slots for added actors in the loaded scene.
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
    void load_with_spawn_slots(std::size_t scene);
    void free_scene_memory(std::size_t scene, std::uint64_t bytes);
    void measure_memory_growth(std::size_t scene, const std::function<void()>& work);
    void attempt(std::size_t scene, const std::function<void(ScanRenderer&)>& work);
};

}  // namespace relidar::serve
