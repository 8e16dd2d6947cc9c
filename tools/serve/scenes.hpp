// SPDX-License-Identifier: Apache-2.0
// The runs that are served: what is known of each is kept, the surfels of those used last
// are on the device.
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

/// Serves one thread at a time, that of its device; outlines(), assets() and spawned()
/// are for all.
class SceneSet {
public:
    /// Loads each run, to see that it can be and how large it is.
    /// @param memory_bytes  device memory that scenes may hold together; beyond it the
    /// one used longest ago goes
    /// @param assets  that may be spawned; it outlives this
    /// @throws DataError for a run that cannot be read, or is larger than that alone
    SceneSet(Device& device, std::vector<SceneSource> sources, std::uint64_t memory_bytes,
             const AssetShelf& assets);

    /// Runs without their surfels and ray-drop networks, in the order given. Never
    /// changes.
    const std::vector<Run>& outlines() const { return outlines_; }
    const std::vector<SceneSource>& sources() const { return sources_; }
    const AssetShelf& assets() const { return assets_; }
    SpawnedActors& spawned() { return spawned_; }

    /// Puts actors into a scene, which is loaded anew where there is no place for them.
    /// @return in the order of the wishes
    /// @throws Refusal where a name is taken or an asset does not fit, and where the
    /// device's memory does not do: nothing has changed then
    std::vector<SpawnedActors::Place> spawn(std::size_t scene, const std::vector<SpawnWish>& wishes);

    /// Number of times that a scene had been loaded: later ones do not know what an
    /// earlier one was asked for.
    enum class Load : std::uint64_t {};
    /// Has a scene's renderer do something; loads the scene where it is not there. @param
    /// scene  index into outlines()
    /// @param weather  none: that of its source
    Load use(std::size_t scene, const std::optional<Weather>& weather,
             const std::function<void(ScanRenderer&)>& work);
    /// Has it do what is left of that, before another scene is used. @throws DeviceError
    /// where it was lost in between
    void use_again(std::size_t scene, Load load, const std::function<void(ScanRenderer&)>& work);

    /// Whether its surfels are on the device now.
    bool is_loaded(std::size_t scene) const { return loaded_[scene].renderer != nullptr; }

private:
    struct Loaded {
        std::unique_ptr<ScanRenderer> renderer;  ///< null where it is not loaded
        std::uint64_t bytes = 0;                 ///< on the device, when it was there last
        std::uint64_t used = 0;                  ///< by a clock that counts uses
        Load load{};                             ///< the last one
        std::size_t n_places = 0;                ///< of spawned actors, that it was loaded with
    };

    Device& device_;
    const std::vector<SceneSource> sources_;
    const std::uint64_t memory_bytes_;
    std::vector<Run> outlines_;
    std::vector<Loaded> loaded_;
    const AssetShelf& assets_;
    SpawnedActors spawned_;
    std::uint64_t clock_ = 0;

    void load(std::size_t scene, const Run& run);
    void load_with_places(std::size_t scene);
    void make_room(std::size_t scene, std::uint64_t bytes);
    void count_growth(std::size_t scene, const std::function<void()>& work);
    void attempt(std::size_t scene, const std::function<void(ScanRenderer&)>& work);
};

}  // namespace relidar::serve
