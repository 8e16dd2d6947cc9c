// SPDX-License-Identifier: Apache-2.0
#include "scenes.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>
#include "base/fail.hpp"

#include "refusal.hpp"

namespace relidar::serve {
namespace {

constexpr double kMiB = 1024.0 * 1024.0;

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
        TrainedRun run = sources_[i].load_run_and_select_output_channels();
        load_scene_to_device(i, run);
        // Removes the surfels and the ray-drop network, which need most of the memory.
        run.scene = copy_scene_without_surfels(run.scene);
        run.drop_network = {};
        outlines_.push_back(std::move(run));
        if (loaded_[i].bytes > memory_bytes_)
            fail(
                "cannot serve {}: it needs {:.1f} MiB of device memory, expected at most {:.1f} MiB "
                "(--memory-mib)",
                sources_[i].folder.string(), double(loaded_[i].bytes) / kMiB, double(memory_bytes_) / kMiB);
        unload_scenes_until_memory_suffices(i, 0);
    }
}

SceneSet::SceneLoadNumber SceneSet::load_scene_and_call_with_renderer(
    std::size_t scene_index, const std::optional<Weather>& weather_or_default,
    const std::function<void(ScanRenderer&)>& use_renderer) {
    loaded_[scene_index].used = ++clock_;
    if (!loaded_[scene_index].renderer) {
        unload_scenes_until_memory_suffices(scene_index, loaded_[scene_index].bytes);
        load_scene_with_spawned_actors(scene_index);
    }
    call_with_renderer(scene_index, [&](ScanRenderer& renderer) {
        renderer.set_weather(weather_or_default.value_or(sources_[scene_index].weather));
        use_renderer(renderer);
    });
    // Rendering may have allocated larger arrays, for a sensor with more rays.
    unload_scenes_until_memory_suffices(scene_index, 0);
    return loaded_[scene_index].load;
}

void SceneSet::call_if_scene_was_not_reloaded(std::size_t scene_index, SceneLoadNumber expected_load_number,
                                              const std::function<void(ScanRenderer&)>& use_renderer) {
    if (!loaded_[scene_index].renderer || loaded_[scene_index].load != expected_load_number)
        fail<DeviceError>(
            "cannot render a scan of {}: the scene was unloaded for a later request; send your request again",
            sources_[scene_index].name);
    call_with_renderer(scene_index, use_renderer);
}

void SceneSet::call_with_renderer(std::size_t scene_index,
                                  const std::function<void(ScanRenderer&)>& use_renderer) {
    try {
        call_and_count_allocated_scene_bytes(scene_index,
                                             [&] { use_renderer(*loaded_[scene_index].renderer); });
    } catch (const DeviceError&) {
        // The state of the renderer is unknown, so the next request loads the scene
        // again.
        loaded_[scene_index].renderer.reset();
        throw;
    }
}

void SceneSet::load_scene_to_device(std::size_t scene_index, const TrainedRun& run) {
    SceneInMemory& loaded = loaded_[scene_index];
    loaded.bytes = 0;
    loaded.used = ++clock_;
    loaded.load = SceneLoadNumber(std::uint64_t(loaded.load) + 1);
    call_and_count_allocated_scene_bytes(scene_index, [&] {
        loaded.renderer = std::make_unique<ScanRenderer>(device_, run);
        // Rendering a single ray uploads the complete scene to the device.
        const SimulatedSensor sensor{.rays = {1, 1, {glm::vec3(0.0f)}, {{1.0f, 0.0f, 0.0f}}, {0.0f}, {0}},
                                     .name = "one ray"};
        const PoseTrack track = run.sequence.get_world_from_sensor(0);
        Pose pose = track.pose.front();
        pose.translation += run.sequence.world_offset_m;
        loaded.renderer->render(sensor, ScanRequest{track.time_s.front(), {{track.time_s.front()}, {pose}}});
    });
    const std::uint64_t left = memory_bytes_ - std::min(memory_bytes_, device_.allocated_bytes());
    // Parallel rendering needs copies, but no other scene is unloaded for them.
    const std::uint64_t copies = left / std::max<std::uint64_t>(loaded.bytes, 1);
    const int side_by_side = loaded.renderer->get_max_parallel_scans();
    loaded.renderer->set_max_parallel_scans(
        int(std::min<std::uint64_t>(1 + copies, std::uint64_t(side_by_side))));
}

void SceneSet::load_scene_with_spawned_actors(std::size_t scene_index) {
    const std::vector<SpawnedActorRegistry::SpawnSlot> slots = spawned_.list_all_slots(scene_index);
    TrainedRun run = sources_[scene_index].load_run_and_select_output_channels();
    add_spawned_actors_to_run(run, slots, assets_);
    load_scene_to_device(scene_index, run);
    loaded_[scene_index].n_slots = slots.size();
}

std::vector<SpawnedActorRegistry::SpawnSlot> SceneSet::spawn_actors(std::size_t scene_index,
                                                                    const std::vector<ActorToSpawn>& actors) {
    SceneInMemory& loaded = loaded_[scene_index];
    const std::size_t n_before = spawned_.count_spawn_slots_of_scene(scene_index);
    std::vector<SpawnedActorRegistry::SpawnSlot> occupied_slots =
        spawned_.assign_actors_to_slots(scene_index, actors);
    if (loaded.renderer && loaded.n_slots == spawned_.count_spawn_slots_of_scene(scene_index))
        return occupied_slots;
    const auto undo = [&] {
        // The next request loads the scene again, without the actors.
        loaded.renderer.reset();
        spawned_.undo_actor_slot_assignment(scene_index, occupied_slots, n_before);
    };
    try {
        loaded.renderer.reset();
        unload_scenes_until_memory_suffices(scene_index, loaded.bytes);
        load_scene_with_spawned_actors(scene_index);
        unload_scenes_until_memory_suffices(scene_index, 0);
    } catch (const DataError& error) {
        undo();
        refuse(grpc::StatusCode::FAILED_PRECONDITION, "cannot spawn {} actors: {}", actors.size(),
               error.what());
    } catch (const OutOfDeviceMemory& error) {
        undo();
        refuse(grpc::StatusCode::RESOURCE_EXHAUSTED, "cannot spawn {} actors: {}", actors.size(),
               error.what());
    } catch (...) {
        undo();
        throw;
    }
    if (loaded.bytes <= memory_bytes_) return occupied_slots;
    const double needed_mib = double(loaded.bytes) / kMiB;
    undo();
    refuse(grpc::StatusCode::RESOURCE_EXHAUSTED,
           "cannot spawn {} actors: the scene would need {:.1f} MiB, expected at most {:.1f} (--memory-mib)",
           actors.size(), needed_mib, double(memory_bytes_) / kMiB);
}

/// Unloads the least recently used scenes first.
void SceneSet::unload_scenes_until_memory_suffices(std::size_t kept_scene_index,
                                                   std::uint64_t n_bytes_needed) {
    while (device_.allocated_bytes() + n_bytes_needed > memory_bytes_) {
        SceneInMemory* oldest = nullptr;
        for (std::size_t i = 0; i < loaded_.size(); ++i)
            if (i != kept_scene_index && loaded_[i].renderer && (!oldest || loaded_[i].used < oldest->used))
                oldest = &loaded_[i];
        if (!oldest) return;
        oldest->renderer.reset();
    }
}

/// Adds the device memory that the function allocates to the size of the scene.
void SceneSet::call_and_count_allocated_scene_bytes(std::size_t scene_index,
                                                    const std::function<void()>& allocate) {
    const std::uint64_t before = device_.allocated_bytes();
    allocate();
    loaded_[scene_index].bytes += device_.allocated_bytes() - before;
}

}  // namespace relidar::serve
