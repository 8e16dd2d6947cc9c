// SPDX-License-Identifier: Apache-2.0
// The surfels of a run are on the device only if it was used recently.
#pragma once

#include <functional>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "scene_source.hpp"
#include "spawned.hpp"

namespace relidar::serve {

using RendererTask = std::function<void(ScanRenderer&)>;
/// Loading discards pending scans, so a changed number shows that a scan is lost.
enum class SceneLoadNumber : std::uint64_t {};

/// Only the render thread may use it, except for runs(), assets() and spawned().
class SceneSet {
public:
    /// Loads each run once to check it and to measure its size on the device.
    /// @param memory_bytes device memory for all scenes together; if it is exceeded, the
    /// least recently used scene is unloaded
    /// @param assets must outlive this object
    /// @throws DataError if a run cannot be read, or does not fit alone
    SceneSet(Device& device, std::vector<SceneSource> sources, std::uint64_t memory_bytes,
             const AssetCatalogue& assets);

    /// Without ray-drop networks too. In the order of the constructor's argument.
    const std::vector<Run>& runs() const { return outlines_; }
    const std::vector<SceneSource>& sources() const { return sources_; }
    const AssetCatalogue& assets() const { return assets_; }
    SpawnedActorRegistry& spawned() { return spawned_; }

    /// Adds actors to the scene without loading it again.
    /// @return the slots of the actors, in the order of the requests
    /// @throws RejectedRequest if a name is in use, if an asset does not fit, or if the
    /// device memory is too small; the scene is then unchanged
    std::vector<SpawnSlot> spawn_actors(std::size_t scene, const std::vector<ActorToSpawn>& actors);

    /// Calls a function with the renderer of a scene. Loads the scene first if it is not
    /// on the device.
    /// @param weather without a value, the default weather of the scene
    /// @return number of this load
    SceneLoadNumber use_scene(std::size_t scene, const std::optional<Weather>& weather,
                              const RendererTask& use);
    /// Reads the results of a scan after use_scene(), which
    /// returned the load number. No other scene may be used in between.
    /// @throws DeviceError if the device was lost, or if the scene was loaded again
    void reuse_scene(std::size_t scene, SceneLoadNumber load, const RendererTask& use);

    bool is_scene_on_gpu(std::size_t scene) const { return loaded_[scene].renderer != nullptr; }

private:
    struct SceneInMemory {
        std::unique_ptr<ScanRenderer> renderer;
        std::uint64_t bytes = 0;
        std::uint64_t used = 0;   ///< Value of clock_ at the last use. The lowest is unloaded first.
        SceneLoadNumber load{};   ///< Number of the most recent load of the scene.
        std::size_t n_slots = 0;  ///< Number of slots for added actors in the loaded scene.
    };

    Device& device_;
    const std::vector<SceneSource> sources_;
    const std::uint64_t memory_bytes_;
    std::vector<Run> outlines_;
    std::vector<SceneInMemory> loaded_;
    const AssetCatalogue& assets_;
    SpawnedActorRegistry spawned_;
    std::uint64_t clock_ = 0;  ///< number of uses of all scenes

    void load_scene(std::size_t scene, const Run& run);
    void load_spawned(std::size_t scene, std::size_t n_actors);
    void spawn_missing(std::size_t scene);
    void make_room(std::size_t kept, std::uint64_t n_bytes = 0);
    void count_bytes(std::size_t scene, const std::function<void()>& allocate);
    void call_renderer(std::size_t scene, const RendererTask& use);
};

}  // namespace relidar::serve
