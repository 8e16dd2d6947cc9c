// SPDX-License-Identifier: Apache-2.0
// Extracts an actor of a run as a separate run, without surfels that are never visible.
// Completes the unobserved side of vehicles with mirrored surfels.

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/base/files.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/render.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "base/sigmoid.hpp"

namespace relidar {
namespace {

/// Returns the name of an asset, for example "car-3". It contains only characters that
/// are valid in file names. If an object has no class, the name is its track id.
std::string make_asset_name(const BoxTrack& box) {
    std::string name = is_discovered(box) ? box.id : box.category + "-" + box.id;
    for (char& c : name) {
        const auto byte = static_cast<unsigned char>(c);
        if (byte < 0x80 && std::isalnum(byte)) c = char(std::tolower(byte));
        else if (c != '.' && c != '_') c = '-';
    }
    return name.front() == '.' ? "-" + name : name;
}

/// Returns true if a surfel can be visible. Its opacity must reach the blending
/// threshold, and it must lie inside the box of its model.
bool is_useful(const Surfels& surfels, std::size_t i, const SurfelModel& model, const ImageModel& image) {
    const glm::vec3 outside = glm::abs(surfels.mean[i]) - model.half_size_m;
    const bool bounded = model.half_size_m.x > 0.0f;
    if (bounded && (outside.x > 0.0f || outside.y > 0.0f || outside.z > 0.0f)) return false;
    return sigmoid(surfels.opacity_logit[i]) >= image.alpha_min;
}

/// Returns the frames of a log in which an actor is present, without their scans.
Log log_of_actor(const Log& full, const BoxTrack& actor_box) {
    Log log = strip_frames(full);
    log.boxes = {actor_box};
    log.world_from_vehicle = {};
    for (const Frame& frame : full.frames) {
        if (!actor_box.is_observed(frame.time_s)) continue;
        log.frames.push_back(
            {.index = frame.index, .time_s = frame.time_s, .scan = {}, .lidar = frame.lidar});
        PoseTrack& track = log.world_from_vehicle;
        if (!track.time_s.empty() && track.time_s.back() == frame.time_s) continue;
        track.time_s.push_back(frame.time_s);
        track.pose.push_back(full.world_from_vehicle.pose[full.find_pose_index(frame)]);
    }
    return log;
}

// Replaces a LiDAR of the log whose rays change from scan to scan.
constexpr const char* kStandIn = "HDL-64E";

/// Returns one sensor for each LiDAR of the log, or its stand-in.
std::vector<SimulatedSensor> sensors_of_log(const Run& run) {
    std::vector<SimulatedSensor> sensors;
    for (int i = 0; i < int(run.log.lidars.size()); ++i) {
        sensors.push_back(choose_sensor("native", run.config, run.log, i));
        const SimulatedSensor& log_sensor = sensors.back();
        if (log_sensor.rays.size() == 0 && !log_sensor.pattern)
            sensors.back() = choose_sensor(kStandIn, run.config, run.log, i);
    }
    return sensors;
}

/// Returns the training frames in which the log has a box of at least one instance.
/// @param boxes [instances] null if an instance has no box
std::vector<int> frames_with_actors(const Run& run, const std::vector<const BoxTrack*>& boxes) {
    std::vector<int> positions;
    for (const int position : run.split.train) {
        const double time_s = run.log.frames[std::size_t(position)].time_s;
        const auto is_present = [&](const BoxTrack* box) { return box && box->is_observed(time_s); };
        if (std::ranges::any_of(boxes, is_present)) positions.push_back(position);
    }
    return positions;
}

/// Adds the hits of a scan to the actors, as points and ray directions in the box frame.
/// @param boxes [instances] null if an instance has no box
/// @param observed output, by track
void add_observations(const RenderedScan& scan, const Run& run, const std::vector<const BoxTrack*>& boxes,
                      ObservationsByTrack& observed) {
    FiringPoseInterpolator firing(scan);
    for (std::size_t i = 0; i < scan.instance.size(); ++i) {
        const BoxTrack* box = scan.instance[i] > 0 ? boxes[std::size_t(scan.instance[i])] : nullptr;
        if (!box || !is_ray_returned(scan.image.drop_prob[i], scan.median_range_m[i])) continue;
        const Pose box_from_world =
            inverse(box->world_from_box.pose_at(scan.time_s + double(scan.time_offset_s[i])));
        const Pose& world_from_firing = firing.pose_of(i);
        const glm::dvec3 point_m =
            box_from_world * (world_from_firing * scan.end_of<double>(i) - run.log.world_offset_m);
        // Skips returns from surfels that were mirrored to fill an unobserved side of the
        // actor. The log has not observed them.
        const SurfelModel& model = run.scene.models[run.scene.instances[std::size_t(scan.instance[i])].model];
        if (model.surface && model.surface->find_mirrored_side(point_m)) continue;
        ActorObservations& actor = observed[box->id];
        actor.points_m.push_back(glm::vec3(point_m));
        actor.directions.push_back(glm::vec3(box_from_world.rotation * world_from_firing.rotation *
                                             glm::dvec3(scan.image.direction[i])));
        actor.nearest_m = std::min(actor.nearest_m, double(scan.median_range_m[i]));
    }
}

namespace fs = std::filesystem;

constexpr const char* kAssetFormat = "relidar asset";
constexpr int kAssetVersion = 1;
constexpr double kAssetMost = 1e9;  // largest valid count or length
constexpr ObjectKind kAssetKinds[] = {ObjectKind::vehicle, ObjectKind::cyclist, ObjectKind::person,
                                      ObjectKind::other};

/// Returns the text of the file that read_description() reads.
std::string to_json(const AssetDescription& facts) {
    nlohmann::ordered_json sides;
    for (std::size_t s = 0; s < kBoxSides; ++s) sides[name_of(BoxSide(s))] = facts.seen_sides[s];
    const nlohmann::ordered_json json = {
        {"format", kAssetFormat},
        {"version", kAssetVersion},
        {"name", facts.name},
        {"class", facts.category},
        {"kind", name_of(facts.kind)},
        {"size_m", {facts.size_m.x, facts.size_m.y, facts.size_m.z}},
        {"source", {{"run", facts.source_run}, {"track", facts.source_track}, {"sensor", facts.sensor}}},
        {"score", facts.covered_share()},
        {"seen", facts.seen},
        {"seen_sides", sides},
        {"completed", facts.completed},
        {"clearance_m", facts.clearance_m},
        {"nearest_m", facts.nearest_m},
        {"surfels", facts.surfels},
        {"mirrored_surfels", facts.mirrored}};
    return json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

/// Describes an actor of a run by its box and the parts of the box that the log observed.
AssetDescription describe_actor(const Run& run, const BoxTrack& box, const ObservedBoxSurface& surface,
                                double nearest_m) {
    AssetDescription facts;
    facts.name = make_asset_name(box);
    facts.category = is_discovered(box) ? name_of(class_of(box)) : box.category;
    facts.kind = guess_kind(box);
    facts.size_m = box.size_m;
    facts.source_run = file_name_of(run.folder);
    facts.source_track = box.id;
    facts.sensor = run.log.lidars.front().sensor.name;
    for (std::size_t s = 0; s < kBoxSides; ++s) facts.seen_sides[s] = surface.observed_fraction(BoxSide(s));
    facts.seen = surface.observed_fraction();
    facts.nearest_m = nearest_m;
    facts.clearance_m = ground_clearance({run.scene, run.log}, box.id).value_or(0.0);
    return facts;
}

ObjectKind read_kind(const JsonField& field) {
    const std::string word = field.text();
    const auto kind = std::ranges::find_if(kAssetKinds, [&](ObjectKind k) { return word == name_of(k); });
    if (kind == std::end(kAssetKinds))
        field.reject("found \"" + word + "\"", "expected vehicle, cyclist, person or other");
    return *kind;
}

}  // namespace

ObservedBoxSurface observed_surface(const glm::dvec3& box_size_m, const ActorObservations& observations) {
    ObservedBoxSurface surface(box_size_m);
    for (std::size_t i = 0; i < observations.points_m.size(); ++i)
        surface.mark_observed(glm::dvec3(observations.points_m[i]), glm::dvec3(observations.directions[i]));
    return surface;
}

ActorAsset extract_asset(const Run& run, const std::string& track, const ActorObservations& observations) {
    SceneWithLog alone = run.driving_scene();
    std::vector<std::string> others = actor_names(alone.scene);
    std::erase(others, track);
    alone = remove_background(std::move(alone));
    for (const std::string& other : others) alone = remove_track(std::move(alone), other);
    const auto box = std::ranges::find_if(alone.log.boxes, [&](const BoxTrack& b) { return b.id == track; });
    if (alone.scene.instances.size() != 2 || box == alone.log.boxes.end())
        fail<UsageError>("cannot make an asset of \"{}\": the run has no such actor, expected one of: {}",
                         track, fmt::join(others, ", "));

    ObservedBoxSurface surface = observed_surface(box->size_m, observations);
    ActorAsset asset;
    asset.facts = describe_actor(run, *box, surface, observations.nearest_m);
    AssetDescription& facts = asset.facts;

    // Removes surfels that are never visible, and completes the unobserved side.
    SurfelModel& model = alone.scene.models[1];
    Surfels& surfels = alone.scene.surfels;
    std::vector<std::uint32_t> visible;
    for (std::uint32_t i = 0; i < surfels.size(); ++i)
        if (is_useful(surfels, i, model, run.config.image)) visible.push_back(i);
    surfels = surfels.reorder(visible);
    if (facts.kind == ObjectKind::vehicle) {
        facts.mirrored = mirror_unobserved(surfels, surface);
        facts.completed = surface.is_completed ? surface.mirrorable_fraction() : 0.0;
    }
    // Sorts neighbours together again, because the mirrored surfels were appended.
    surfels = surfels.reorder(kd_tree_order(surfels.mean));
    facts.surfels = surfels.size();

    // Makes a run with this actor, which has the name of the asset.
    BoxTrack named = *box;
    named.id = facts.name;
    model = {facts.name, 0, std::uint32_t(surfels.size()), model.half_size_m, model.stride_m, surface};
    alone.scene.models[0].first = 0;
    alone.scene.instances[1].track = facts.name;
    alone.scene.sensor_drop = {};
    for (Lidar& lidar : alone.log.lidars) lidar.own_body = {};
    asset.run.config = run.config;
    asset.run.log = log_of_actor(alone.log, named);
    for (int i = 0; i < int(asset.run.log.frames.size()); ++i) asset.run.split.train.push_back(i);
    asset.run.scene = std::move(alone.scene);
    asset.run.edits = run.edits;
    asset.run.edits.push_back({facts.source_run, fmt::format("asset of {}", track)});
    asset.run.refined_poses = run.refined_poses;
    return asset;
}

std::string only_track(const Run& run) {
    const std::vector<std::string> tracks = actor_names(run.scene);
    if (tracks.size() == 1) return tracks.front();
    fail<UsageError>("{} is a run with {} actors, expected an asset, or RUN#TRACK{}", run.folder.string(),
                     tracks.size(),
                     tracks.empty() ? "" : fmt::format(" whose track is one of {}", fmt::join(tracks, ", ")));
}

ObservationsByTrack observe_actors(Device& device, const Run& run, const Progress& progress) {
    std::vector<const BoxTrack*> boxes;
    for (const ModelInstance& instance : run.scene.instances)
        boxes.push_back(find_box(run.log, instance.track));
    const std::vector<int> positions = frames_with_actors(run, boxes);
    const std::vector<SimulatedSensor> sensors = sensors_of_log(run);
    ObservationsByTrack sightings;
    ScanRenderer renderer(device, run.scene, run.config, run.log);
    for (std::size_t k = 0; k < positions.size(); ++k) {
        if (progress) progress("measuring the visibility of actors", double(k) / double(positions.size()));
        const Frame& frame = run.log.frames[std::size_t(positions[k])];
        add_observations(renderer.render(sensors[std::size_t(frame.lidar)], frame.time_s), run, boxes,
                         sightings);
    }
    return sightings;
}

void save_asset(ActorAsset asset, const fs::path& folder) {
    asset.run.folder = folder;
    save_run(asset.run);
    write_text_file(folder / kAssetFile, to_json(asset.facts));
}

AssetDescription read_description(const fs::path& folder) {
    const std::string file = (folder / kAssetFile).string();
    const nlohmann::json json = parse_json(read_text_file(file), file);
    const JsonField root(json, file, "");
    if (const std::string format = root.at("format").text(); format != kAssetFormat)
        root.at("format").reject("found \"" + format + "\"", fmt::format("expected \"{}\"", kAssetFormat));
    root.at("version").integer_in(kAssetVersion, kAssetVersion);
    AssetDescription facts;
    facts.name = root.at("name").short_text(200);
    facts.category = root.at("class").short_text(200);
    facts.kind = read_kind(root.at("kind"));
    const std::array<double, 3> size_m = root.at("size_m").numbers<3>();
    facts.size_m = {size_m[0], size_m[1], size_m[2]};
    facts.source_run = root.at("source").at("run").text();
    facts.source_track = root.at("source").at("track").text();
    facts.sensor = root.at("source").at("sensor").short_text(200);
    for (std::size_t s = 0; s < kBoxSides; ++s)
        facts.seen_sides[s] = root.at("seen_sides").at(name_of(BoxSide(s))).number_in(0.0, 1.0);
    facts.seen = root.at("seen").number_in(0.0, 1.0);
    facts.completed = root.at("completed").number_in(0.0, 1.0);
    facts.clearance_m = root.at("clearance_m").number_in(-kAssetMost, kAssetMost);
    facts.nearest_m = root.at("nearest_m").number_in(0.0, kAssetMost);
    facts.surfels = std::size_t(root.at("surfels").integer_in(0, std::int64_t(kAssetMost)));
    facts.mirrored = std::size_t(root.at("mirrored_surfels").integer_in(0, std::int64_t(kAssetMost)));
    return facts;
}

std::optional<double> read_clearance(const Run& run) {
    if (run.folder.empty() || !does_path_exist(run.folder / kAssetFile)) return {};
    return read_description(run.folder).clearance_m;
}

std::vector<fs::path> list_assets(const fs::path& folder) {
    require_folder(folder, "a folder of `relidar assets`");
    std::vector<fs::path> assets = list_folder(folder);
    std::erase_if(assets, [](const fs::path& entry) { return !does_path_exist(entry / kAssetFile); });
    if (assets.empty())
        fail("{} contains no asset, expected folders with an {}", folder.string(), kAssetFile);
    return assets;
}

}  // namespace relidar
