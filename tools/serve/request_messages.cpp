// SPDX-License-Identifier: Apache-2.0
#include "request_messages.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string_view>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "asset_catalogue.hpp"
#include "geometry_messages.hpp"
#include "refusal.hpp"
#include "scenes.hpp"
#include "sensor_messages.hpp"

namespace relidar::serve {
namespace {

constexpr int kMostSensors = 64;                // Maximum number of sensors of a rig.
constexpr std::size_t kLongestSpawnName = 200;  // Maximum length in bytes of the name of a spawned actor.
// Longest time in seconds between a scan and the nearest end of the sensor's path. A
// sweep may begin before the path or end after it, but a larger difference is an error.
constexpr double kBeyondPath_s = 1.0;

bool is_far_beyond(double time_s, const PoseTrack& path) {
    const bool moves = path.pose.size() > 1;
    return moves &&
           (time_s < path.time_s.front() - kBeyondPath_s || time_s > path.time_s.back() + kBeyondPath_s);
}

/// Reads a time in seconds. Rejects a time that is more than one second outside the
/// sensor's path.
double read_moment(double time_s, const PoseTrack& path, const std::string& field) {
    read_time(time_s, field);
    if (is_far_beyond(time_s, path))
        throw_refusal(
            field,
            fmt::format("the time {} s for a path from {} to {} s", time_s, path.time_s.front(),
                        path.time_s.back()),
            fmt::format("a time in seconds on the path, or at most {} s before or after it", kBeyondPath_s));
    return time_s;
}

std::vector<std::string> list_actor_names(const std::vector<PlacedActor>& actors) {
    std::vector<std::string> names;
    for (const PlacedActor& actor : actors) names.push_back(actor.name);
    return names;
}

/// Reads the names and poses of the actors in a request.
/// @throws Refusal if the poses of an actor end long before the scan or begin long after
/// it
std::vector<ActorRequest> read_actors(const v1::ActorTracks& message, double time_s) {
    std::vector<ActorRequest> wishes;
    for (int i = 0; i < message.actors_size(); ++i) {
        const std::string field = fmt::format("actors.actors[{}]", i);
        wishes.push_back({field + ".name", message.actors(i).name(),
                          read_track(message.actors(i).poses(), field + ".poses")});
        const PoseTrack& track = wishes.back().dataset_from_actor;
        if (is_far_beyond(time_s, track))
            throw_refusal(
                field + ".poses",
                fmt::format("poses from {} to {} s, which do not cover the scan at {} s",
                            track.time_s.front(), track.time_s.back(), time_s),
                fmt::format("poses that cover the time of the scan, or that are at most {} s away from it",
                            kBeyondPath_s));
    }
    return wishes;
}

std::vector<std::string> list_asset_names(const AssetCatalogue& assets) {
    std::vector<std::string> names;
    for (const AssetCatalogue::Entry& entry : assets.entries()) names.push_back(entry.facts.name);
    return names;
}

Weather read_weather(const std::string& text) {
    try {
        return parse_weather(text);
    } catch (const UsageError& error) {
        throw Refusal(grpc::StatusCode::INVALID_ARGUMENT, fmt::format("cannot read {}", error.what()));
    }
}

}  // namespace

std::vector<std::string> list_actor_names_of_run(const Run& run) {
    std::vector<std::string> names;
    for (const Instance& instance : run.scene.instances)
        if (!instance.track.empty()) names.push_back(instance.track);
    return names;
}

RequestReader::RequestReader(SceneSet& scenes)
    : RequestReader(scenes.outlines(), scenes.sources(), scenes.assets(), scenes.spawned()) {}

RequestReader::RequestReader(const std::vector<Run>& outlines, const std::vector<SceneSource>& sources,
                             const AssetCatalogue& assets, const SpawnedActors& spawned)
    : outlines_(outlines), sources_(sources), assets_(assets), spawned_(spawned) {}

std::size_t RequestReader::find_scene(const std::string& name, const std::string& field) const {
    if (name.empty() && sources_.size() == 1) return 0;
    std::vector<std::string> names;
    for (const SceneSource& source : sources_) {
        if (source.name == name) return names.size();
        names.push_back(source.name);
    }
    throw_unknown_name(field, name, names);
}

int RequestReader::find_lidar(std::size_t scene, const std::string& name, const std::string& field) const {
    const std::vector<Lidar>& lidars = outlines_[scene].sequence.lidars;
    if (name.empty()) return 0;
    std::vector<std::string> names;
    for (const Lidar& lidar : lidars) {
        if (lidar.name == name) return int(names.size());
        names.push_back(lidar.name);
    }
    throw_unknown_name(field, name, names);
}

std::pair<std::string, std::shared_ptr<const SensorChoice>> RequestReader::upload(
    const v1::SensorSpec& spec) {
    const std::string handle = uploaded_.add(read_sensor(spec, "sensor"));
    const std::shared_ptr<const SensorChoice> sensor = uploaded_.find(handle);
    if (!sensor)
        throw Refusal(
            grpc::StatusCode::RESOURCE_EXHAUSTED,
            "cannot upload a sensor: too many other sensors were uploaded at the same time; try again");
    return {handle, sensor};
}

/// Returns the sensor with this name. The rays of the sensor are computed once and then
/// cached.
std::shared_ptr<const SensorChoice> RequestReader::find_built_in_sensor(const std::string& name,
                                                                        std::size_t scene, int lidar) {
    const std::string key = fmt::format("{} {} {}", scene, lidar, name);
    if (auto sensor = named_.find(key)) return sensor;
    return named_.put(key, find_named_sensor(name, outlines_[scene], lidar));
}

std::shared_ptr<const SensorChoice> RequestReader::find_sensor(const SensorRequest& request,
                                                               std::size_t scene, int lidar) {
    if (request.returns > 2)
        throw_refusal(request.field + ".returns", fmt::format("{}", request.returns), "0, 1 or 2");
    std::shared_ptr<const SensorChoice> sensor;
    if (request.sensor.has_spec()) {
        sensor =
            std::make_shared<const SensorChoice>(read_sensor(request.sensor.spec(), request.field + ".spec"));
    } else if (request.sensor.has_handle()) {
        sensor = uploaded_.find(request.sensor.handle());
        if (!sensor)
            throw Refusal(
                grpc::StatusCode::NOT_FOUND,
                fmt::format(
                    "cannot read {}.handle: found {}, which is unknown or expired, expected a handle from "
                    "UploadSensor; upload the sensor again",
                    request.field, quoted(request.sensor.handle())));
    } else {
        sensor = find_built_in_sensor(request.sensor.name(), scene, lidar);
    }
    if (count_rays(*sensor) == 0)
        throw_refusal(request.field, "a LiDAR of the log whose beams are unknown",
                      "another sensor, because this LiDAR has no rays outside the scans of the log");
    const int returns = int(request.returns);
    if (sensor->lidar == lidar && sensor->returns == returns) return sensor;
    SensorChoice placed = *sensor;
    placed.lidar = lidar;
    placed.returns = returns;
    return std::make_shared<const SensorChoice>(std::move(placed));
}

/// Returns all actors of a scene: the actors of its run and the actors that clients have
/// added.
std::vector<PlacedActor> RequestReader::list_known_actors(std::size_t scene) const {
    const Run& run = outlines_[scene];
    const auto find_actor_box = [&](const std::string& track) {
        const BoxTrack* box = find_box(run.sequence, track);
        return box ? *box : BoxTrack{};
    };
    std::vector<PlacedActor> actors;
    for (std::size_t i = 0; i < run.scene.instances.size(); ++i) {
        const Instance& instance = run.scene.instances[i];
        if (instance.track.empty()) continue;
        const BoxTrack box = find_actor_box(instance.track);
        actors.push_back({instance.track, instance.track, box.category, i, box.size_m,
                          run.scene.models[instance.model].count});
    }
    for (const SpawnedActors::Place& place : spawned_.list_occupied_slots(scene)) {
        const auto& [is_asset, source] = place.actor.source;
        actors.push_back({place.actor.name, make_track_of_slot(place.position),
                          is_asset ? assets_.find(source)->facts.category : find_actor_box(source).category,
                          run.scene.instances.size() + place.position, place.actor.size_m,
                          place.actor.surfels});
    }
    return actors;
}

void RequestReader::place_actors(const std::vector<ActorRequest>& requests, RenderRequest& request) const {
    const std::vector<PlacedActor> known_placed = list_known_actors(request.scene);
    // A map makes the search by name fast, because a scene may have thousands of actors.
    std::map<std::string_view, const PlacedActor*> by_name;
    for (const PlacedActor& actor : known_placed) by_name.emplace(actor.name, &actor);
    ActorPoses& poses = request.request.dataset_from_actor.emplace();
    for (const ActorRequest& wish : requests) {
        const auto match = by_name.find(wish.name);
        if (match == by_name.end()) throw_unknown_name(wish.field, wish.name, list_actor_names(known_placed));
        if (!poses.emplace(match->second->track, wish.dataset_from_actor).second)
            throw_refusal(wish.field, quoted(wish.name) + " again", "each actor once");
        request.placed.push_back(*match->second);
    }
}

std::vector<ActorToSpawn> RequestReader::read_spawns(const v1::SpawnActorsRequest& message,
                                                     std::size_t scene) const {
    if (message.actors().empty()) throw_refusal("actors", "none", "at least one actor");
    const std::vector<std::string> run_actors = list_actor_names_of_run(outlines_[scene]);
    const std::vector<PlacedActor> known = list_known_actors(scene);
    std::vector<ActorToSpawn> wishes;
    for (int i = 0; i < message.actors_size(); ++i) {
        const v1::Spawn& spawn = message.actors(i);
        const std::string field = fmt::format("actors[{}]", i);
        if (spawn.name().empty() || spawn.name().size() > kLongestSpawnName)
            throw_refusal(field + ".name", quoted(spawn.name()),
                          fmt::format("a name of 1 to {} bytes", kLongestSpawnName));
        if (std::ranges::find(run_actors, spawn.name()) != run_actors.end())
            throw Refusal(
                grpc::StatusCode::ALREADY_EXISTS,
                fmt::format(
                    "cannot read {}.name: found {}, which is an actor of the run, expected another name",
                    field, quoted(spawn.name())));
        if (spawn.has_asset()) {
            const AssetCatalogue::Entry* asset = assets_.find(spawn.asset());
            if (!asset) throw_unknown_name(field + ".asset", spawn.asset(), list_asset_names(assets_));
            wishes.push_back(
                {spawn.name(), {true, spawn.asset()}, asset->facts.size_m, asset->facts.surfels});
            continue;
        }
        if (!spawn.has_actor()) throw_refusal(field, "neither actor nor asset", "one of them");
        const auto actor = std::ranges::find(run_actors, spawn.actor());
        if (actor == run_actors.end()) throw_unknown_name(field + ".actor", spawn.actor(), run_actors);
        // The index also fits `known`, because this list begins with the actors of the
        // run.
        const PlacedActor& model = known[std::size_t(actor - run_actors.begin())];
        wishes.push_back({spawn.name(), {false, spawn.actor()}, model.size_m, model.surfels});
    }
    return wishes;
}

RenderRequest RequestReader::read_scan(const v1::RenderLidarRequest& message, const SensorRequest& request,
                                       const std::optional<Pose>& path_from_sensor) {
    RenderRequest wanted;
    wanted.scene = find_scene(message.scene());
    wanted.sensor = find_sensor(request, wanted.scene, find_lidar(wanted.scene, message.lidar()));
    PoseTrack path = read_track(message.path(), "path");
    wanted.request.time_s = message.has_time_s()
                                ? read_moment(message.time_s(), path, "time_s")
                                : path.time_s.front() - compute_firing_span(*wanted.sensor).first_s;
    wanted.points_at_s = message.has_points_at_s() ? read_moment(message.points_at_s(), path, "points_at_s")
                                                   : path.time_s.back();
    wanted.request.dataset_from_sensor =
        path_from_sensor ? mount_on_track(std::move(path), *path_from_sensor) : std::move(path);
    if (message.has_actors()) place_actors(read_actors(message.actors(), wanted.request.time_s), wanted);
    if (message.has_sample_seed()) wanted.sample = message.sample_seed();
    if (!message.weather().empty()) wanted.weather = read_weather(message.weather());
    if (message.has_wanted()) {
        wanted.points = message.wanted().points();
        wanted.range_image = message.wanted().range_image();
        wanted.drop_probability = message.wanted().drop_probability();
        wanted.boxes = message.wanted().boxes();
    }
    return wanted;
}

RenderRequest RequestReader::read(const v1::RenderLidarRequest& message) {
    return read_scan(message, {message.sensor(), "sensor", message.returns()}, {});
}

std::vector<RenderRequest> RequestReader::read(const v1::RenderRigRequest& message) {
    if (message.sensors().empty() || message.sensors_size() > kMostSensors)
        throw_refusal("sensors", fmt::format("a rig with {} sensors", message.sensors_size()),
                      fmt::format("1 to {}", kMostSensors));
    std::vector<RenderRequest> scans;
    // names of the sensors, to detect duplicates; a name is optional
    std::set<std::string_view> names;
    for (int i = 0; i < message.sensors_size(); ++i) {
        const v1::RigSensor& sensor = message.sensors(i);
        const std::string field = fmt::format("sensors[{}]", i);
        if (!sensor.name().empty() && !names.insert(sensor.name()).second)
            throw_refusal(field + ".name", quoted(sensor.name()) + " again",
                          "a different name for each sensor");
        const Pose rig_from_sensor = read_pose(sensor.rig_from_sensor(), field + ".rig_from_sensor");
        scans.push_back(read_scan(message.rig(), {sensor.sensor(), field + ".sensor", sensor.returns()},
                                  rig_from_sensor));
    }
    return scans;
}

}  // namespace relidar::serve
