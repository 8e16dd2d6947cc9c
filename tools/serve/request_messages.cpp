// SPDX-License-Identifier: Apache-2.0
#include "request_messages.hpp"

#include <algorithm>
#include <set>

#include <relidar/base/error.hpp>
#include <relidar/scene/labels.hpp>

#include "asset_catalogue.hpp"
#include "geometry_messages.hpp"
#include "refusal.hpp"
#include "scenes.hpp"

namespace relidar::serve {
namespace {

constexpr int kMostSensors = 64;                // Maximum number of sensors of a rig.
constexpr std::size_t kLongestSpawnName = 200;  // Maximum length in bytes of the name of a spawned actor.
// Seconds between a scan and the nearest end of the sensor's path.
constexpr double kBeyondPath_s = 1.0;

bool is_far_from_path(double time_s, const PoseTrack& path) {
    const bool moves = path.pose.size() > 1;
    return moves &&
           (time_s < path.time_s.front() - kBeyondPath_s || time_s > path.time_s.back() + kBeyondPath_s);
}

/// Checks a time and returns it. Rejects times more than one second outside the sensor's
/// path, because the pose of the sensor is unknown there.
double time_near_path(double time_s, const PoseTrack& path, const std::string& field) {
    checked_number(time_s, field);
    if (is_far_from_path(time_s, path))
        reject_field(field,
                     fmt::format("{} s, but the path covers {} to {} s", time_s, path.time_s.front(),
                                 path.time_s.back()),
                     fmt::format("a time at most {} s away from the path", kBeyondPath_s));
    return time_s;
}

template <class Items>
std::vector<std::string> list_names(const Items& items) {
    std::vector<std::string> names;
    for (const auto& item : items) names.push_back(item.name);
    return names;
}

template <class Items>
std::size_t find_index_of_name(const Items& items, const std::string& name, const std::string& field) {
    const auto match = std::ranges::find_if(items, [&](const auto& item) { return item.name == name; });
    if (match == items.end()) reject_name(field, name, list_names(items));
    return std::size_t(match - items.begin());
}

/// Reads the names and poses of the actors in a request. Rejects an actor whose poses end
/// before the scan or begin after it, except for a tolerance of one second.
std::vector<RequestedActor> read_actors(const v1::ActorTracks& message, double scan_time_s) {
    std::vector<RequestedActor> actors;
    for (int i = 0; i < message.actors_size(); ++i) {
        const std::string field = fmt::format("actors.actors[{}]", i);
        actors.push_back({field + ".name", message.actors(i).name(),
                          read_track(message.actors(i).poses(), field + ".poses")});
        const PoseTrack& track = actors.back().dataset_from_actor;
        if (is_far_from_path(scan_time_s, track))
            reject_field(field + ".poses",
                         fmt::format("poses from {} to {} s for a scan at {} s", track.time_s.front(),
                                     track.time_s.back(), scan_time_s),
                         fmt::format("poses at most {} s away from the scan", kBeyondPath_s));
    }
    return actors;
}

std::vector<std::string> list_asset_names(const AssetCatalogue& assets) {
    std::vector<std::string> names;
    for (const AssetCatalogue::CatalogueEntry& entry : assets.entries()) names.push_back(entry.facts.name);
    return names;
}

Weather read_weather(const std::string& text) {
    try {
        return parse_weather(text);
    } catch (const UsageError& error) {
        refuse(Code::INVALID_ARGUMENT, "cannot read {}", error.what());
    }
}

}  // namespace

std::vector<std::string> run_actor_names(const Run& run) { return actor_names(run.scene); }

RequestReader::RequestReader(SceneSet& scenes)
    : RequestReader(scenes.runs(), scenes.sources(), scenes.assets(), scenes.spawned()) {}

RequestReader::RequestReader(const std::vector<Run>& outlines, const std::vector<SceneSource>& sources,
                             const AssetCatalogue& assets, const SpawnedActorRegistry& spawned)
    : outlines_(outlines), sources_(sources), assets_(assets), spawned_(spawned) {}

std::size_t RequestReader::find_scene(const std::string& scene_name, const std::string& field) const {
    if (scene_name.empty() && sources_.size() == 1) return 0;
    return find_index_of_name(sources_, scene_name, field);
}

int RequestReader::find_lidar(std::size_t scene, const std::string& name, const std::string& field) const {
    if (name.empty()) return 0;
    return int(find_index_of_name(outlines_[scene].log.lidars, name, field));
}

std::pair<std::string, SensorPtr> RequestReader::cache_sensor(const v1::SensorSpec& spec) {
    return uploaded_.add_upload(read_sensor(spec, "sensor"));
}

SensorPtr RequestReader::find_built_in(const std::string& sensor_name, std::size_t scene, int lidar) {
    const std::string key = fmt::format("{} {} {}", scene, lidar, sensor_name);
    if (auto sensor = named_.find_cached(key)) return sensor;
    return named_.add_sensor(key, find_known_sensor(sensor_name, outlines_[scene], lidar));
}

/// Returns the sensor of a request: a description in the request, the handle of an
/// uploaded sensor, or the name of a built-in sensor.
SensorPtr RequestReader::requested_sensor(const SensorRequest& request, std::size_t scene, int lidar) {
    if (request.returns > 2)
        reject_field(request.field + ".returns", fmt::format("{}", request.returns), "0, 1 or 2");
    SensorPtr sensor;
    if (request.sensor.has_spec()) {
        sensor = std::make_shared<const SimulatedSensor>(
            read_sensor(request.sensor.spec(), request.field + ".spec"));
    } else if (request.sensor.has_handle()) {
        sensor = uploaded_.find_cached(request.sensor.handle());
        if (!sensor)
            refuse(Code::NOT_FOUND,
                   "cannot read {}.handle: {} is unknown or expired; upload the sensor again", request.field,
                   quote_client_text(request.sensor.handle()));
    } else {
        sensor = find_built_in(request.sensor.name(), scene, lidar);
    }
    if (count_rays(*sensor) == 0)
        reject_field(
            request.field, "a LiDAR of the log whose beams are unknown",
            "another sensor, because ray directions of this LiDAR are known only for the scans of the log");
    // The cached sensor is shared by many requests. Copies it if this request needs
    // another LiDAR or another number of returns.
    const int returns = int(request.returns);
    if (sensor->lidar == lidar && sensor->returns == returns) return sensor;
    SimulatedSensor copy = *sensor;
    copy.lidar = lidar;
    copy.returns = returns;
    return std::make_shared<const SimulatedSensor>(std::move(copy));
}

/// Returns all actors of a scene: first the actors of its run, then the actors that
/// clients have added.
std::vector<VisibleActor> RequestReader::scene_actors(std::size_t scene) const {
    const Run& run = outlines_[scene];
    const auto find_actor_box = [&](const std::string& track) {
        const BoxTrack* box = find_box(run.log, track);
        return box ? *box : BoxTrack{};
    };
    std::vector<VisibleActor> actors;
    for (std::size_t i = 0; i < run.scene.instances.size(); ++i) {
        const ModelInstance& instance = run.scene.instances[i];
        if (instance.track.empty()) continue;  // the background
        const BoxTrack box = find_actor_box(instance.track);
        actors.push_back({.name = instance.track,
                          .track = instance.track,
                          .category = box.category,
                          .instance = i,
                          .size_m = box.size_m,
                          .surfels = run.scene.models[instance.model].count});
    }
    for (const SpawnSlot& slot : spawned_.list_occupied(scene)) {
        const SpawnedModelSource& source = slot.actor.source;
        const std::string category = source.is_asset ? assets_.find_asset(source.name)->facts.category
                                                     : find_actor_box(source.name).category;
        // The renderer adds the slots behind the instances of the run.
        actors.push_back({.name = slot.actor.name,
                          .track = slot_track_name(slot.position),
                          .category = category,
                          .instance = run.scene.instances.size() + slot.position,
                          .size_m = slot.actor.size_m,
                          .surfels = slot.actor.surfels});
    }
    return actors;
}

/// Shows only the listed actors of the scene, at the requested poses.
void RequestReader::set_visible(const std::vector<RequestedActor>& actors,
                                RenderRequest& render_request) const {
    const std::vector<VisibleActor> visible_actors = scene_actors(render_request.scene);
    // A map makes the search by name fast, because a scene may have thousands of actors.
    std::map<std::string_view, const VisibleActor*> by_name;
    for (const VisibleActor& actor : visible_actors) by_name.emplace(actor.name, &actor);
    ActorTracksByName& poses = render_request.request.dataset_from_actor.emplace();
    for (const RequestedActor& actor : actors) {
        const auto match = by_name.find(actor.name);
        if (match == by_name.end()) reject_name(actor.field, actor.name, list_names(visible_actors));
        const bool is_new = poses.emplace(match->second->track, actor.dataset_from_actor).second;
        if (!is_new)
            reject_field(actor.field, quote_client_text(actor.name) + " a second time",
                         "each actor at most once");
        render_request.placed.push_back(*match->second);
    }
}

/// Reads a request to add actors to a scene. The surfels of a new actor are copied from
/// an asset or from an actor of the run.
std::vector<ActorToSpawn> RequestReader::read_spawn(const v1::SpawnActorsRequest& message,
                                                    std::size_t scene) const {
    if (message.actors().empty()) reject_field("actors", "none", "at least one actor");
    const std::vector<std::string> run_actors = run_actor_names(outlines_[scene]);
    const std::vector<VisibleActor> visible_actors = scene_actors(scene);
    std::vector<ActorToSpawn> actors;
    for (int i = 0; i < message.actors_size(); ++i) {
        const v1::Spawn& spawn = message.actors(i);
        const std::string field = fmt::format("actors[{}]", i);
        if (spawn.name().empty() || spawn.name().size() > kLongestSpawnName)
            reject_field(field + ".name", quote_client_text(spawn.name()),
                         fmt::format("a name of 1 to {} bytes", kLongestSpawnName));
        if (std::ranges::count(run_actors, spawn.name()) > 0)
            refuse(Code::ALREADY_EXISTS,
                   "cannot spawn {}: an actor of the run already has the name {}; use another name", field,
                   quote_client_text(spawn.name()));
        ActorToSpawn& actor = actors.emplace_back();
        actor.name = spawn.name();
        if (spawn.has_asset()) {
            const AssetCatalogue::CatalogueEntry* asset = assets_.find_asset(spawn.asset());
            if (!asset) reject_name(field + ".asset", spawn.asset(), list_asset_names(assets_));
            actor.source = {.is_asset = true, .name = spawn.asset()};
            actor.size_m = asset->facts.size_m;
            actor.surfels = asset->facts.surfels;
        } else if (spawn.has_actor()) {
            if (std::ranges::count(run_actors, spawn.actor()) == 0)
                reject_name(field + ".actor", spawn.actor(), run_actors);
            // Names of spawned actors differ from those of the run.
            const VisibleActor& model =
                *std::ranges::find(visible_actors, spawn.actor(), &VisibleActor::name);
            actor.source = {.is_asset = false, .name = spawn.actor()};
            actor.size_m = model.size_m;
            actor.surfels = model.surfels;
        } else {
            reject_field(field, "neither an actor nor an asset", "one of them");
        }
    }
    return actors;
}

/// Reads a request for one scan. If its time is missing, the first ray is fired at the
/// first pose of the path. By default, points are in the sensor frame at the last pose.
RenderRequest RequestReader::read_one(const v1::RenderLidarRequest& message, const SensorRequest& sensor,
                                      const std::optional<Pose>& rig_from_sensor) {
    RenderRequest scan;
    scan.scene = find_scene(message.scene());
    scan.sensor = requested_sensor(sensor, scan.scene, find_lidar(scan.scene, message.lidar()));
    PoseTrack path = read_track(message.path(), "path");
    scan.request.time_s = message.has_time_s() ? time_near_path(message.time_s(), path, "time_s")
                                               : path.time_s.front() - firing_span(*scan.sensor).first_s;
    scan.points_at_s = message.has_points_at_s() ? time_near_path(message.points_at_s(), path, "points_at_s")
                                                 : path.time_s.back();
    scan.request.dataset_from_sensor =
        rig_from_sensor ? mount_track(std::move(path), *rig_from_sensor) : std::move(path);
    if (message.has_actors()) set_visible(read_actors(message.actors(), scan.request.time_s), scan);
    if (message.has_sample_seed()) scan.sample = message.sample_seed();
    if (!message.weather().empty()) scan.weather = read_weather(message.weather());
    if (message.has_wanted()) {
        scan.points = message.wanted().points();
        scan.range_image = message.wanted().range_image();
        scan.drop_probability = message.wanted().drop_probability();
        scan.boxes = message.wanted().boxes();
    }
    return scan;
}

RenderRequest RequestReader::read_request(const v1::RenderLidarRequest& message) {
    return read_one(message, {message.sensor(), "sensor", message.returns()}, {});
}

/// Reads a request for several sensors on one vehicle. Returns one scan request per
/// sensor, in which the path of the vehicle becomes the path of the sensor.
std::vector<RenderRequest> RequestReader::read_rig(const v1::RenderRigRequest& message) {
    if (message.sensors().empty() || message.sensors_size() > kMostSensors)
        reject_field("sensors", fmt::format("a rig with {} sensors", message.sensors_size()),
                     fmt::format("1 to {} sensors", kMostSensors));
    std::vector<RenderRequest> scans;
    std::set<std::string_view> names;
    for (int i = 0; i < message.sensors_size(); ++i) {
        const v1::RigSensor& sensor = message.sensors(i);
        const std::string field = fmt::format("sensors[{}]", i);
        if (!names.insert(sensor.name()).second)
            reject_field(field + ".name", quote_client_text(sensor.name()) + " a second time",
                         "a different name for each sensor");
        const Pose rig_from_sensor = read_pose(sensor.rig_from_sensor(), field + ".rig_from_sensor");
        scans.push_back(
            read_one(message.rig(), {sensor.sensor(), field + ".sensor", sensor.returns()}, rig_from_sensor));
    }
    return scans;
}

}  // namespace relidar::serve
