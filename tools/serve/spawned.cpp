// SPDX-License-Identifier: Apache-2.0
#include "spawned.hpp"

#include <algorithm>
#include <map>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "asset_catalogue.hpp"
#include "refusal.hpp"

namespace relidar::serve {
namespace {

// Maximum number of slots that are added at the same time. With
// image.sh_direction=surfel, even an unused slot needs memory for a copy of the surfels.
constexpr std::size_t kMostSpare = 8;

using SpawnedPlaces = std::vector<ActorToSpawn>;

auto find_spawned(SpawnedPlaces& places, const std::string& name) {
    return std::ranges::find(places, name, &ActorToSpawn::name);
}

/// Returns the index of a free slot for the same model. If there is none, adds slots and
/// returns the first new one.
std::size_t free_place(SpawnedPlaces& places, const ActorToSpawn& actor) {
    const auto is_free = [&](const ActorToSpawn& p) { return p.name.empty() && p.source == actor.source; };
    const auto free = std::ranges::find_if(places, is_free);
    if (free != places.end()) return std::size_t(free - places.begin());
    const auto of_source = std::size_t(std::ranges::count(places, actor.source, &ActorToSpawn::source));
    if (places.size() >= SpawnedActors::kMostPlaces)
        throw Refusal(
            grpc::StatusCode::RESOURCE_EXHAUSTED,
            fmt::format("cannot spawn {}: this scene already has {} spawned actors, which is the maximum",
                        quoted(actor.name), places.size()));
    const std::size_t first = places.size();
    ActorToSpawn empty = actor;
    empty.name.clear();
    places.resize(
        std::min(first + std::clamp<std::size_t>(of_source, 1, kMostSpare), SpawnedActors::kMostPlaces),
        empty);
    return first;
}

std::uint32_t find_model_of_actor(const Scene& scene, const std::string& track) {
    const auto instance = std::ranges::find(scene.instances, track, &Instance::track);
    if (instance == scene.instances.end())
        throw DataError(fmt::format("cannot spawn {}: the run no longer has this actor", track));
    return instance->model;
}

/// Loads an asset and adds its surfel model to the scene.
std::uint32_t add_asset(Scene& scene, const std::filesystem::path& folder) {
    const Run asset = load_run(folder);
    return append_model(scene, asset.scene, find_model_of_actor(asset.scene, find_only_track(asset)));
}

}  // namespace

std::vector<SpawnedActors::Place> SpawnedActors::places(std::size_t scene) const {
    const std::lock_guard lock(mutex_);
    std::vector<Place> all;
    for (const ActorToSpawn& actor : scenes_[scene]) all.push_back({all.size(), actor});
    return all;
}

std::vector<SpawnedActors::Place> SpawnedActors::list_occupied_slots(std::size_t scene) const {
    std::vector<Place> all = places(scene);
    std::erase_if(all, [](const Place& place) { return place.actor.name.empty(); });
    return all;
}

std::size_t SpawnedActors::count_places(std::size_t scene) const {
    const std::lock_guard lock(mutex_);
    return scenes_[scene].size();
}

std::vector<SpawnedActors::Place> SpawnedActors::take(std::size_t scene,
                                                      const std::vector<ActorToSpawn>& actors) {
    const std::lock_guard lock(mutex_);
    // Changes only this copy, so that a rejected request has no effect.
    SpawnedPlaces places = scenes_[scene];
    std::vector<Place> new_places;
    for (const ActorToSpawn& wish : actors) {
        if (find_spawned(places, wish.name) != places.end())
            throw Refusal(grpc::StatusCode::ALREADY_EXISTS,
                          fmt::format("cannot spawn {}: an actor with this name exists; use another name",
                                      quoted(wish.name)));
        const std::size_t position = free_place(places, wish);
        places[position] = wish;
        new_places.push_back({position, wish});
    }
    scenes_[scene] = std::move(places);
    return new_places;
}

void SpawnedActors::release(std::size_t scene, const std::vector<std::string>& names) {
    const std::lock_guard lock(mutex_);
    SpawnedPlaces places = scenes_[scene];
    for (const std::string& name : names) {
        const auto place = find_spawned(places, name);
        if (name.empty() || place == places.end())
            throw Refusal(
                grpc::StatusCode::NOT_FOUND,
                fmt::format(
                    "cannot despawn {}: no spawned actor has this name, or the request names it twice",
                    quoted(name)));
        place->name.clear();
    }
    scenes_[scene] = std::move(places);
}

void SpawnedActors::undo(std::size_t scene, const std::vector<Place>& places, std::size_t n_before) {
    const std::lock_guard lock(mutex_);
    for (const Place& place : places) scenes_[scene][place.position].name.clear();
    scenes_[scene].resize(n_before);
}

std::string make_track_of_slot(std::size_t position) { return fmt::format("\x01spawned {}", position); }

void add_places(Run& run, const std::vector<SpawnedActors::Place>& places, const AssetCatalogue& assets) {
    std::map<std::string, std::uint32_t> models;  // Index of the surfel model of each asset.
    for (const SpawnedActors::Place& place : places) {
        const SpawnSource& source = place.actor.source;
        std::uint32_t model = 0;
        if (!source.is_asset) model = find_model_of_actor(run.scene, source.name);
        else if (const auto model_entry = models.find(source.name); model_entry != models.end())
            model = model_entry->second;
        else {
            const AssetCatalogue::Entry& asset = *assets.find(source.name);
            model = models[source.name] = add_asset(run.scene, asset.folder);
            // The channel "class" reads the kind of the asset from this box.
            run.sequence.boxes.push_back({.id = run.scene.models[model].name,
                                          .category = get_name(asset.facts.kind),
                                          .size_m = asset.facts.size_m,
                                          .world_from_box = {}});
        }
        run.scene.instances.push_back({model, make_track_of_slot(place.position)});
    }
}

}  // namespace relidar::serve
