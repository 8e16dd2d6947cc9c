// SPDX-License-Identifier: Apache-2.0
#include "scenes.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "refusal.hpp"

namespace relidar::serve {
namespace {

constexpr double kMiB = 1024.0 * 1024.0;

/// Returns the run without its surfels and its ray-drop network, which need most of the
/// memory.
Run copy_without_model_data(Run run) {
    run.scene = copy_layout(run.scene);
    run.drop_network = {};
    return run;
}

/// Returns a sensor with a single ray. Rendering this ray uploads the complete scene to
/// the device.
SensorChoice make_one_ray() {
    return {.rays = {1, 1, {glm::vec3(0.0f)}, {{1.0f, 0.0f, 0.0f}}, {0.0f}, {0}}, .name = "one ray"};
}

ScanRequest make_first_pose_request(const Run& run) {
    const PoseTrack track = run.sequence.world_from_sensor(0);
    Pose pose = track.pose.front();
    pose.translation += run.sequence.world_offset_m;
    return {track.time_s.front(), {{track.time_s.front()}, {pose}}};
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
        Run run = sources_[i].load();
        load(i, run);
        outlines_.push_back(copy_without_model_data(std::move(run)));
        if (loaded_[i].bytes > memory_bytes_)
            throw DataError(fmt::format(
                "cannot serve {}: it needs {:.1f} MiB of device memory, expected at most {:.1f} MiB "
                "(--memory-mib)",
                sources_[i].folder.string(), double(loaded_[i].bytes) / kMiB, double(memory_bytes_) / kMiB));
        free_scene_memory(i, 0);
    }
}

SceneSet::Load SceneSet::use(std::size_t scene, const std::optional<Weather>& weather,
                             const std::function<void(ScanRenderer&)>& work) {
    loaded_[scene].used = ++clock_;
    if (!loaded_[scene].renderer) {
        free_scene_memory(scene, loaded_[scene].bytes);
        load_with_spawn_slots(scene);
    }
    attempt(scene, [&](ScanRenderer& renderer) {
        renderer.set_weather(weather.value_or(sources_[scene].weather));
        work(renderer);
    });
    // Unloads other scenes if memory is exceeded, because rendering may have allocated
    // larger arrays for a sensor with more rays.
    free_scene_memory(scene, 0);
    return loaded_[scene].load;
}

void SceneSet::call_with_loaded_scene(std::size_t scene, Load load,
                                      const std::function<void(ScanRenderer&)>& work) {
    if (!loaded_[scene].renderer || loaded_[scene].load != load)
        throw DeviceError(fmt::format(
            "cannot render a scan of {}: the scene was unloaded for a later request", sources_[scene].name));
    attempt(scene, work);
}

void SceneSet::attempt(std::size_t scene, const std::function<void(ScanRenderer&)>& work) {
    try {
        measure_memory_growth(scene, [&] { work(*loaded_[scene].renderer); });
    } catch (const DeviceError&) {
        // The state of the renderer is unknown after an error. The next request loads the
        // scene again.
        loaded_[scene].renderer.reset();
        throw;
    }
}

void SceneSet::load(std::size_t scene, const Run& run) {
    Loaded& loaded = loaded_[scene];
    loaded.bytes = 0;
    loaded.used = ++clock_;
    loaded.load = Load(std::uint64_t(loaded.load) + 1);
    measure_memory_growth(scene, [&] {
        loaded.renderer = std::make_unique<ScanRenderer>(device_, run);
        loaded.renderer->render(make_one_ray(), make_first_pose_request(run));
    });
    const std::uint64_t left = memory_bytes_ - std::min(memory_bytes_, device_.allocated_bytes());
    // Number of copies of the scene that fit into the free memory. Copies allow parallel
    // rendering, but they must not displace another scene.
    const std::uint64_t copies = left / std::max<std::uint64_t>(loaded.bytes, 1);
    const int side_by_side = loaded.renderer->side_by_side();
    loaded.renderer->side_by_side(int(std::min<std::uint64_t>(1 + copies, std::uint64_t(side_by_side))));
}

/// Loads the run together with the actors that clients have added.
void SceneSet::load_with_spawn_slots(std::size_t scene) {
    const std::vector<SpawnedActors::Place> places = spawned_.places(scene);
    Run run = sources_[scene].load();
    add_places(run, places, assets_);
    load(scene, run);
    loaded_[scene].n_places = places.size();
}

std::vector<SpawnedActors::Place> SceneSet::spawn(std::size_t scene,
                                                  const std::vector<ActorToSpawn>& actors) {
    Loaded& loaded = loaded_[scene];
    const std::size_t n_before = spawned_.count_places(scene);
    std::vector<SpawnedActors::Place> places = spawned_.take(scene, actors);
    if (loaded.renderer && loaded.n_places == spawned_.count_places(scene)) return places;
    const auto undo = [&] {
        // Without the renderer, the next request loads the scene again, without the new
        // actors.
        loaded.renderer.reset();
        spawned_.undo(scene, places, n_before);
    };
    try {
        loaded.renderer.reset();
        free_scene_memory(scene, loaded.bytes);
        load_with_spawn_slots(scene);
        free_scene_memory(scene, 0);
    } catch (const DataError& error) {
        undo();
        throw Refusal(grpc::StatusCode::FAILED_PRECONDITION,
                      fmt::format("cannot spawn {} actors: {}", actors.size(), error.what()));
    } catch (const OutOfDeviceMemory& error) {
        undo();
        throw Refusal(grpc::StatusCode::RESOURCE_EXHAUSTED,
                      fmt::format("cannot spawn {} actors: {}", actors.size(), error.what()));
    } catch (...) {
        undo();
        throw;
    }
    if (loaded.bytes <= memory_bytes_) return places;
    const double needed_mib = double(loaded.bytes) / kMiB;
    undo();
    throw Refusal(
        grpc::StatusCode::RESOURCE_EXHAUSTED,
        fmt::format("cannot spawn {} actors: the scene would need {:.1f} MiB of device memory with them, "
                    "expected at most {:.1f} MiB (--memory-mib of the server)",
                    actors.size(), needed_mib, double(memory_bytes_) / kMiB));
}

/// Unloads other scenes, the least recently used first, until `bytes` more bytes fit into
/// the memory.
void SceneSet::free_scene_memory(std::size_t scene, std::uint64_t bytes) {
    while (device_.allocated_bytes() + bytes > memory_bytes_) {
        Loaded* oldest = nullptr;
        for (std::size_t i = 0; i < loaded_.size(); ++i)
            if (i != scene && loaded_[i].renderer && (!oldest || loaded_[i].used < oldest->used))
                oldest = &loaded_[i];
        if (!oldest) return;
        oldest->renderer.reset();
    }
}

/// Calls a function, and adds the device memory that it allocates to the recorded size of
/// the scene.
void SceneSet::measure_memory_growth(std::size_t scene, const std::function<void()>& work) {
    const std::uint64_t before = device_.allocated_bytes();
    work();
    loaded_[scene].bytes += device_.allocated_bytes() - before;
}

}  // namespace relidar::serve
