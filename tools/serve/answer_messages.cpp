// SPDX-License-Identifier: Apache-2.0
#include "answer_messages.hpp"

#include <algorithm>
#include <bit>

#include <relidar/run/edit.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/actor_boxes.hpp>
#include <relidar/simulate/place_points.hpp>

#include "geometry_messages.hpp"
#include "refusal.hpp"
#include "sensor_messages.hpp"

namespace relidar::serve {
namespace {

static_assert(std::endian::native == std::endian::little,
              "relidar sends arrays in the byte order of this machine, which must be little-endian");

template <class T>
void copy_bytes(std::string& output_bytes, const std::vector<T>& array) {
    output_bytes.assign(reinterpret_cast<const char*>(array.data()), array.size() * sizeof(T));
}

/// Writes channels as descriptions and raw bytes. A vector has three components.
template <class Messages>
void add_channels(const std::vector<ScanChannel>& channels, Messages& channel_messages) {
    for (const auto& [info, values, second] : channels) {
        v1::Channel& message = *channel_messages.Add();
        message.set_name(info.name);
        message.set_unit(info.unit);
        message.set_meaning(info.meaning);
        message.set_components(std::holds_alternative<std::vector<glm::vec3>>(values) ? 3 : 1);
        message.set_is_integer(std::holds_alternative<std::vector<std::int32_t>>(values));
        std::visit([&](const auto& of_rays) { copy_bytes(*message.mutable_values(), of_rays); }, values);
    }
}

/// Writes the points of a scan. Each field holds the values of all points as raw bytes.
void write_points(const LidarPoints& points, v1::Points& message) {
    message.set_count(std::uint32_t(points.size()));
    copy_bytes(*message.mutable_xyz_m(), points.position_m);
    copy_bytes(*message.mutable_intensity(), points.intensity);
    copy_bytes(*message.mutable_ring(), points.ring);
    copy_bytes(*message.mutable_time_s(), points.time_offset_s);
    copy_bytes(*message.mutable_instance(), points.instance);
    // Without numbers, all points are first returns.
    if (points.return_number.empty()) message.mutable_return_number()->assign(points.size(), 1);
    else copy_bytes(*message.mutable_return_number(), points.return_number);
    add_channels(points.channels, *message.mutable_channels());
}

std::size_t count_firsts(const LidarPoints& points) {
    if (points.return_number.empty()) return points.size();
    return std::size_t(std::ranges::count(points.return_number, 1));
}

/// Describes an actor: its class, size, and the length and times of its path.
void write_actor(const Run& run, const std::string& actor_name, v1::Actor& message) {
    message.set_name(actor_name);
    const BoxTrack* box = find_box(run.log, actor_name);
    if (!box) return;
    const PoseTrack& track = box->world_from_box;
    message.set_category(name_of(class_of(*box)));
    message.set_label(label_of(*box));
    write_vector(box->size_m, *message.mutable_size_m());
    message.set_poses(track.pose.size());
    // Length of the path through all poses.
    double length_m = 0.0;
    for (std::size_t i = 1; i < track.pose.size(); ++i)
        length_m += glm::distance(track.pose[i].translation, track.pose[i - 1].translation);
    message.set_length_m(length_m);
    if (track.time_s.empty()) return;
    message.set_begin_s(track.time_s.front());
    message.set_end_s(track.time_s.back());
}

}  // namespace

/// Writes the times and counts of a scan and, if the client wants them, its points.
void write_scan(const RenderedPoints& scan, const RenderRequest& request, v1::LidarScan& message) {
    message.set_sensor(request.sensor->name);
    message.set_time_s(scan.points.time_s);
    message.set_points_at_s(request.points_at_s);
    write_pose(scan.points.world_from_points, *message.mutable_dataset_from_points());
    message.set_rays(std::uint32_t(scan.n_rays));
    message.set_returned(std::uint32_t(count_firsts(scan.points)));
    if (scan.unseen_share) message.set_unseen(*scan.unseen_share);
    if (request.points) write_points(scan.points, *message.mutable_points());
}

/// Writes a scan that was rendered as an image. Adds the parts of the image that the
/// client wants: ranges with intensities, or drop probabilities.
void write_scan(const RenderedScan& scan, const RenderRequest& request, const Config& config,
                v1::LidarScan& message) {
    // Points are in the sensor frame at the time points_at_s.
    const Pose dataset_from_points = request.request.dataset_from_sensor.pose_at(request.points_at_s);
    write_scan(
        {place_points(scan, config, dataset_from_points), scan.image.range_m.size(), scan.unseen_share},
        request, message);
    if (!request.range_image && !request.drop_probability) return;
    v1::RangeImage& image = *message.mutable_image();
    image.set_rows(std::uint32_t(scan.image.rows));
    image.set_columns(std::uint32_t(scan.image.columns));
    if (request.drop_probability) copy_bytes(*image.mutable_drop_probability(), scan.image.drop_prob);
    if (!request.range_image) return;
    copy_bytes(*image.mutable_range_m(), scan.image.range_m);
    copy_bytes(*image.mutable_intensity(), scan.image.intensity);
    add_channels(scan.channels, *image.mutable_channels());
}

/// Writes the box of each visible actor, with its pose, velocity and number of points.
/// The names are the names that the client has used in its request.
void write_boxes(const RenderedScan& scan, const RenderRequest& request, const Run& run,
                 v1::LidarScan& message) {
    ScanOutputOptions format = default_options(run, *request.sensor);
    std::map<std::string, std::string> name_of_track;
    // Replaces the actors of the run by those of the request, at the requested poses.
    // Without poses in the request, actors are visible at their recorded poses.
    if (request.request.dataset_from_actor) {
        format.actors.clear();
        for (const VisibleActor& actor : request.placed) {
            name_of_track[actor.track] = actor.name;
            format.instance_names.resize(std::max(format.instance_names.size(), actor.instance + 1));
            format.instance_names[actor.instance] = actor.track;
            format.actors.push_back({actor.track, actor.category, actor.size_m, {}});
        }
        move_actor_boxes(format, *request.request.dataset_from_actor);
    }
    for (const ActorBox& box : actor_boxes_of(scan, format)) {
        v1::ActorBox& written = *message.add_boxes();
        const auto name = name_of_track.find(box.track);
        written.set_name(name == name_of_track.end() ? box.track : name->second);
        written.set_category(name_of(box.object_class));
        written.set_label(box.label);
        written.set_is_discovered(box.is_discovered);
        write_vector(box.size_m, *written.mutable_size_m());
        written.set_time_s(box.time_s);
        write_pose(box.dataset_from_box, *written.mutable_dataset_from_box());
        write_vector(box.velocity_mps, *written.mutable_velocity_mps());
        written.set_points(box.n_points);
        written.set_visible_share(box.visible_share);
        written.set_is_static(box.is_static);
        written.set_note(name_of(box.note));
    }
}

/// Describes a scene: its times, LiDARs and actors.
void write_scene(const std::string& scene_name, const Run& run, v1::Scene& message) {
    const Log& log = run.log;
    message.set_name(scene_name);
    message.set_begin_s(log.frames.front().time_s);
    message.set_end_s(log.frames.back().time_s);
    message.set_sampled_noise(std::ranges::any_of(
        log.lidars, [](const Lidar& lidar) { return !lidar.range_noise.sigma_m.empty(); }));
    for (std::size_t i = 0; i < log.lidars.size(); ++i) {
        const Lidar& lidar = log.lidars[i];
        v1::Lidar& added = *message.add_lidars();
        added.set_name(lidar.name);
        added.set_sensor(lidar.sensor.name);
        added.set_rays(count_rays(make_sensor(run.config, log, int(i))));
        added.set_period_s(lidar.sweep_period_s());
    }
    for (const std::string& actor : run_actor_names(run)) write_actor(run, actor, *message.add_actors());
}

void write_tracks(const Run& run, int lidar, const google::protobuf::RepeatedPtrField<std::string>& actors,
                  v1::GetTracksResponse& message) {
    const Log& log = run.log;
    const auto in_dataset = [&](const PoseTrack& track) { return shift_track(track, log.world_offset_m); };
    write_track(in_dataset(log.lidar_track(lidar)), *message.mutable_dataset_from_sensor());
    if (std::size_t(actors.size()) > run.scene.instances.size())
        reject_field("actors", fmt::format("{} names", actors.size()), "each actor at most once");
    std::vector<std::string> names(actors.begin(), actors.end());
    if (names.empty()) names = run_actor_names(run);
    for (const std::string& name : names) {
        const BoxTrack* box = find_box(run.log, name);
        if (!box)
            refuse(Code::NOT_FOUND, "cannot read actors: found {}, expected an actor that ListScenes lists",
                   quote_client_text(name));
        v1::ActorTrack& track = *message.add_actors();
        track.set_name(name);
        write_track(in_dataset(box->world_from_box), *track.mutable_poses());
    }
}

/// Describes an asset that clients can spawn.
void write_asset(const AssetDescription& asset, v1::Asset& message) {
    message.set_name(asset.name);
    message.set_category(asset.category);
    message.set_kind(name_of(asset.kind));
    write_vector(asset.size_m, *message.mutable_size_m());
    message.set_score(asset.covered_share());
    message.set_seen(asset.seen);
    message.set_nearest_m(asset.nearest_m);
    message.set_surfels(asset.surfels);
    message.set_sensor(asset.sensor);
}

void write_spawned(const SpawnSlot& slot, const Run& run, v1::SpawnedActor& message) {
    message.set_name(slot.actor.name);
    if (slot.actor.source.is_asset) message.set_asset(slot.actor.source.name);
    else message.set_actor(slot.actor.source.name);
    message.set_instance(std::uint32_t(run.scene.instances.size() + slot.position));
    write_vector(slot.actor.size_m, *message.mutable_size_m());
    message.set_surfels(slot.actor.surfels);
}

/// Warns the client about actors that have too few surfels for their distance from the
/// sensor, so that their scans are too coarse.
void write_sparse_actors(const RenderRequest& request, v1::LidarScan& message) {
    if (request.placed.empty()) return;
    const ScanRequest& scan = request.request;
    const SimulatedSensor& sensor = *request.sensor;
    // Rays that change from scan to scan are not stored in the sensor.
    const bool has_rays = sensor.rays.size() > 0 || !sensor.pattern;
    const RayTable computed_rays = has_rays ? RayTable{} : make_rays(*sensor.pattern, scan.time_s);
    const RayTable& rays = has_rays ? sensor.rays : computed_rays;
    const Pose dataset_from_sensor = scan.dataset_from_sensor.pose_at(scan.time_s);
    for (const VisibleActor& actor : request.placed) {
        const Pose dataset_from_box = scan.dataset_from_actor->at(actor.track).pose_at(scan.time_s);
        const Pose box_from_sensor = inverse(dataset_from_box) * dataset_from_sensor;
        const ActorModelResolution detail =
            model_resolution(rays.origin, rays.direction, box_from_sensor, actor.size_m, actor.surfels);
        if (!detail.is_too_coarse()) continue;
        v1::SparseActor& sparse = *message.add_sparse_actors();
        sparse.set_name(actor.name);
        sparse.set_distance_m(detail.nearest_m);
        sparse.set_rays(detail.rays);
        sparse.set_surfels(detail.surfels);
    }
}

}  // namespace relidar::serve
