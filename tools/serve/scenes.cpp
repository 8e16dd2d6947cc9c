// SPDX-License-Identifier: Apache-2.0
#include "scenes.hpp"

#include <algorithm>

#include <relidar/gpu/out_of_memory.hpp>
#include "base/fail.hpp"

#include "refusal.hpp"

namespace relidar::serve {
namespace {

constexpr double kMiB = 1024.0 * 1024.0;

/// Renders a single ray at the start of the log, which uploads the scene to the device.
void render_one_ray(ScanRenderer& renderer, const Log& log) {
    RayTable one_ray;
    one_ray.rows = one_ray.columns = 1;
    one_ray.origin.push_back(glm::vec3(0.0f));
    one_ray.direction.push_back(glm::vec3(1.0f, 0.0f, 0.0f));
    one_ray.time_offset_s.push_back(0.0f);
    one_ray.channel.push_back(0);
    const PoseTrack path = shift_track(log.lidar_track(0), log.world_offset_m);
    const double time_s = path.time_s.front();
    renderer.render({.rays = one_ray, .name = "one ray"},
                    ScanRequest{time_s, {{time_s}, {path.pose.front()}}});
}

}  // namespace

SceneSet::SceneSet(Device& device, std::vector<SceneSource> sources, std::uint64_t memory_bytes,
                   const AssetCatalogue& assets)
    : device_(device),
      sources_(std::move(sources)),
      memory_bytes_(memory_bytes),
      loaded_(sources_.size()),
      assets_(assets),
      spawned_(sources_.size()) {
    for (std::size_t i = 0; i < sources_.size(); ++i) {
        // Loads each scene once to check it and to measure its size. Then keeps only the
        // log and the settings, because the surfels need most of the memory.
        Run run = sources_[i].load();
        load_scene(i, run);
        run.scene = strip_surfels(run.scene);
        run.drop_network = {};
        outlines_.push_back(std::move(run));
        if (loaded_[i].bytes > memory_bytes_)
            fail(
                "cannot serve {}: it needs {:.1f} MiB of device memory, expected at most {:.1f} MiB "
                "(--memory-mib)",
                sources_[i].folder.string(), double(loaded_[i].bytes) / kMiB, double(memory_bytes_) / kMiB);
        make_room(i);
    }
}

SceneLoadNumber SceneSet::use_scene(std::size_t scene, const std::optional<Weather>& weather,
                                    const RendererTask& use) {
    loaded_[scene].used = ++clock_;
    if (!loaded_[scene].renderer) {
        make_room(scene, loaded_[scene].bytes);
        load_scene(scene, sources_[scene].load());
        spawn_missing(scene);
    }
    call_renderer(scene, [&](ScanRenderer& renderer) {
        renderer.set_weather(weather.value_or(sources_[scene].weather));
        use(renderer);
    });
    // Rendering may have allocated larger arrays, for a sensor with more rays. Unloads
    // other scenes if all scenes together now need too much memory.
    make_room(scene);
    return loaded_[scene].load;
}

void SceneSet::reuse_scene(std::size_t scene, SceneLoadNumber load, const RendererTask& use) {
    if (!loaded_[scene].renderer || loaded_[scene].load != load)
        fail<DeviceError>(
            "cannot render a scan of {}: the scene was unloaded for a later request; send your request again",
            sources_[scene].name);
    call_renderer(scene, use);
}

/// Calls a function with the renderer of a loaded scene.
void SceneSet::call_renderer(std::size_t scene, const RendererTask& use) {
    try {
        count_bytes(scene, [&] { use(*loaded_[scene].renderer); });
    } catch (const DeviceError&) {
        // The state of the renderer is unknown. The next request loads the scene again.
        loaded_[scene].renderer.reset();
        throw;
    }
}

/// Loads a run to the device, without spawned actors, and measures its size in bytes.
/// Allows as many parallel scans as the free memory permits.
void SceneSet::load_scene(std::size_t scene, const Run& run) {
    SceneInMemory& loaded = loaded_[scene];
    loaded.bytes = 0;  // count_bytes() adds the bytes that a function allocates.
    loaded.n_slots = 0;
    loaded.used = ++clock_;
    loaded.load = SceneLoadNumber(std::uint64_t(loaded.load) + 1);
    count_bytes(scene, [&] {
        loaded.renderer = std::make_unique<ScanRenderer>(device_, run);
        render_one_ray(*loaded.renderer, run.log);
    });
    // Each further parallel scan needs a copy of the scene. No other scene is unloaded
    // for such copies. The scenes can exceed the limit, and then no bytes are free.
    const std::uint64_t free_bytes = memory_bytes_ - std::min(memory_bytes_, device_.allocated_bytes());
    const std::uint64_t n_copies = free_bytes / std::max<std::uint64_t>(loaded.bytes, 1);
    const auto n_supported = std::uint64_t(loaded.renderer->max_parallel());
    loaded.renderer->set_parallel(int(std::min(1 + n_copies, n_supported)));
}

/// Adds the slots for spawned actors that the loaded scene does not have yet.
void SceneSet::spawn_missing(std::size_t scene) {
    const std::vector<SpawnSlot> slots = spawned_.list_all_slots(scene);
    SceneInMemory& loaded = loaded_[scene];
    count_bytes(scene, [&] { spawn_slots(*loaded.renderer, slots, loaded.n_slots, assets_); });
    loaded.n_slots = slots.size();
}

/// Assigns a slot, an additional instance of a model, to each new actor, and loads the
/// models. If this fails, frees the slots, so that the request has no effect.
std::vector<SpawnSlot> SceneSet::spawn_actors(std::size_t scene, const std::vector<ActorToSpawn>& actors) {
    SceneInMemory& loaded = loaded_[scene];
    const std::size_t n_slots_before = spawned_.list_all_slots(scene).size();
    std::vector<SpawnSlot> occupied_slots = spawned_.assign_slots(scene, actors);
    // A slot that a removed actor has left already has its model in the renderer.
    const bool has_all_models = loaded.n_slots == spawned_.list_all_slots(scene).size();
    if (loaded.renderer && has_all_models) return occupied_slots;
    try {
        load_spawned(scene, actors.size());
    } catch (...) {
        // The next request loads the scene again, without these actors.
        loaded.renderer.reset();
        spawned_.undo_assign(scene, occupied_slots, n_slots_before);
        throw;
    }
    return occupied_slots;
}

/// Loads a scene with all its spawned actors. Other scenes may be unloaded.
/// @param n_actors number of new actors, for errors
/// @throws RejectedRequest if an asset does not fit, or if the memory is too small
void SceneSet::load_spawned(std::size_t scene, std::size_t n_actors) {
    SceneInMemory& loaded = loaded_[scene];
    try {
        if (!loaded.renderer) {
            make_room(scene, loaded.bytes);  // as many bytes as after the last load
            load_scene(scene, sources_[scene].load());
        }
        spawn_missing(scene);
        make_room(scene);  // The spawned models may exceed the limit.
    } catch (const DataError& error) {
        refuse(Code::FAILED_PRECONDITION, "cannot spawn {} actors: {}", n_actors, error.what());
    } catch (const OutOfDeviceMemory& error) {
        refuse(Code::RESOURCE_EXHAUSTED, "cannot spawn {} actors: {}", n_actors, error.what());
    }
    // This scene alone exceeds the limit, although the device has more memory.
    if (loaded.bytes > memory_bytes_)
        refuse(
            Code::RESOURCE_EXHAUSTED,
            "cannot spawn {} actors: the scene would need {:.1f} MiB, expected at most {:.1f} (--memory-mib)",
            n_actors, double(loaded.bytes) / kMiB, double(memory_bytes_) / kMiB);
}

/// Unloads other scenes, the least recently used first, until `n_bytes` more bytes fit
/// into the device memory. Never unloads the scene `kept`.
void SceneSet::make_room(std::size_t kept, std::uint64_t n_bytes) {
    while (device_.allocated_bytes() + n_bytes > memory_bytes_) {
        SceneInMemory* oldest = nullptr;
        for (std::size_t i = 0; i < loaded_.size(); ++i)
            if (i != kept && loaded_[i].renderer && (!oldest || loaded_[i].used < oldest->used))
                oldest = &loaded_[i];
        if (!oldest) return;
        oldest->renderer.reset();
    }
}

void SceneSet::count_bytes(std::size_t scene, const std::function<void()>& allocate) {
    const std::uint64_t before = device_.allocated_bytes();
    allocate();
    loaded_[scene].bytes += device_.allocated_bytes() - before;
}

}  // namespace relidar::serve
