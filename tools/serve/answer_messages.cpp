// SPDX-License-Identifier: Apache-2.0
#include "answer_messages.hpp"

#include <algorithm>
#include <bit>
#include <cstring>

#include <fmt/format.h>

#include "geometry_messages.hpp"
#include "refusal.hpp"
#include "sensor_messages.hpp"

namespace relidar::serve {
namespace {

static_assert(std::endian::native == std::endian::little,
              "arrays of messages are sent as they lie in memory");

template <class T>
void append(std::string& bytes, const T& value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof(T));
}

template <class T>
void set_array(std::string& bytes, const std::vector<T>& values) {
    bytes.assign(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

template <class Messages>
void write_channels(const std::vector<ScanChannel>& channels, Messages& messages) {
    for (const auto& [info, values, second] : channels) {
        v1::Channel& message = *messages.Add();
        message.set_name(info.name);
        message.set_unit(info.unit);
        message.set_meaning(info.meaning);
        message.set_components(std::holds_alternative<std::vector<glm::vec3>>(values) ? 3 : 1);
        message.set_is_integer(std::holds_alternative<std::vector<std::int32_t>>(values));
        std::visit([&](const auto& of_rays) { set_array(*message.mutable_values(), of_rays); }, values);
    }
}

/// Rotates the last value of a channel into the frame of the points if the channel holds
/// directions.
void turn_last(ScanChannel& of_points, const Pose& points_from_firing) {
    auto* vectors = std::get_if<std::vector<glm::vec3>>(&of_points.values);
    if (vectors && of_points.info.turns)
        vectors->back() = glm::vec3(points_from_firing.rotation * glm::dvec3(vectors->back()));
}

void write_points(const RenderedScan& scan, const Pose& dataset_from_points, const Config& config,
                  v1::Points& points) {
    FiringPoses firing(scan, inverse(dataset_from_points));
    const std::vector<float>& range_m = point_ranges(scan, config);
    std::vector<ScanChannel> channels = emptied(scan.channels);
    std::uint32_t n = 0;
    const auto add = [&](std::size_t ray, float range, float intensity, std::uint8_t number) {
        const Pose& points_from_firing = firing.at(ray);
        const glm::dvec3 seen_m =
            glm::dvec3(scan.image.origin[ray]) + double(range) * glm::dvec3(scan.image.direction[ray]);
        append(*points.mutable_xyz_m(), glm::vec3(points_from_firing * seen_m));
        append(*points.mutable_intensity(), intensity);
        append(*points.mutable_ring(), scan.ring[ray]);
        append(*points.mutable_time_s(), scan.time_offset_s[ray]);
        append(*points.mutable_return_number(), number);
        append(*points.mutable_instance(), number == 1 ? scan.instance[ray] : std::int32_t(-1));
        for (std::size_t k = 0; k < channels.size(); ++k) {
            append_return(channels[k], scan.channels[k], ray, number);
            turn_last(channels[k], points_from_firing);
        }
        ++n;
    };
    for (std::size_t ray = 0; ray < range_m.size(); ++ray) {
        if (!returned(scan.image.drop_prob[ray], range_m[ray])) continue;
        add(ray, range_m[ray], scan.image.intensity[ray], 1);
        std::uint8_t number = 1;
        for (const SecondReturn& echo : scan.second_returns)
            if (++number; echo.range_m[ray] > 0.0f) add(ray, echo.range_m[ray], echo.intensity[ray], number);
    }
    points.set_count(n);
    write_channels(channels, *points.mutable_channels());
}

std::uint32_t count_returned(const RenderedScan& scan) {
    std::uint32_t n = 0;
    for (std::size_t ray = 0; ray < scan.image.range_m.size(); ++ray)
        n += returned(scan.image.drop_prob[ray], scan.image.range_m[ray]);
    return n;
}

/// Fields that all answers with a scan contain.
struct ScanHead {
    double time_s;
    std::size_t rays, returned;
    std::optional<double> unseen_share;
};

void write_head(const ScanHead& scan, const WantedScan& wanted, const Pose& dataset_from_points,
                v1::LidarScan& message) {
    message.set_sensor(wanted.sensor->name);
    message.set_time_s(scan.time_s);
    message.set_points_at_s(wanted.points_at_s);
    write_pose(dataset_from_points, *message.mutable_dataset_from_points());
    message.set_rays(std::uint32_t(scan.rays));
    message.set_returned(std::uint32_t(scan.returned));
    if (scan.unseen_share) message.set_unseen(*scan.unseen_share);
}

double length_m(const PoseTrack& track) {
    double length = 0.0;
    for (std::size_t i = 1; i < track.pose.size(); ++i)
        length += glm::distance(track.pose[i].translation, track.pose[i - 1].translation);
    return length;
}

void write_actor(const Run& run, const std::string& name, v1::Actor& message) {
    message.set_name(name);
    const BoxTrack* box = find_box(run.sequence, name);
    if (!box) return;
    const PoseTrack& track = box->world_from_box;
    message.set_category(box->category);
    message.mutable_size_m()->set_x(box->size_m.x);
    message.mutable_size_m()->set_y(box->size_m.y);
    message.mutable_size_m()->set_z(box->size_m.z);
    message.set_poses(track.pose.size());
    message.set_length_m(length_m(track));
    if (track.time_s.empty()) return;
    message.set_begin_s(track.time_s.front());
    message.set_end_s(track.time_s.back());
}

}  // namespace

void write_scan(const RenderedScan& scan, const WantedScan& wanted, const Config& config,
                v1::LidarScan& message) {
    const Pose dataset_from_points = wanted.request.dataset_from_sensor.at(wanted.points_at_s);
    write_head({scan.time_s, scan.image.range_m.size(), count_returned(scan), scan.unseen_share}, wanted,
               dataset_from_points, message);
    if (wanted.points) write_points(scan, dataset_from_points, config, *message.mutable_points());
    if (!wanted.range_image && !wanted.drop_probability) return;
    v1::RangeImage& image = *message.mutable_image();
    image.set_rows(std::uint32_t(scan.image.rows));
    image.set_columns(std::uint32_t(scan.image.columns));
    if (wanted.drop_probability) set_array(*image.mutable_drop_probability(), scan.image.drop_prob);
    if (!wanted.range_image) return;
    set_array(*image.mutable_range_m(), scan.image.range_m);
    set_array(*image.mutable_intensity(), scan.image.intensity);
    write_channels(scan.channels, *image.mutable_channels());
}

void write_scan(const PointScan& scan, const WantedScan& wanted, v1::LidarScan& message) {
    write_head({scan.time_s, scan.n_rays, scan.points.size(), scan.unseen_share}, wanted,
               scan.dataset_from_points, message);
    v1::Points& points = *message.mutable_points();
    const auto set = [&](std::string& bytes, const auto& value_of) {
        using Value = decltype(value_of(scan.points[0]));
        bytes.resize(scan.points.size() * sizeof(Value));
        for (std::size_t i = 0; i < scan.points.size(); ++i) {
            const Value value = value_of(scan.points[i]);
            std::memcpy(bytes.data() + i * sizeof(Value), &value, sizeof(Value));
        }
    };
    set(*points.mutable_xyz_m(), [](const ScanPoint& p) { return p.position_m; });
    set(*points.mutable_intensity(), [](const ScanPoint& p) { return p.intensity; });
    set(*points.mutable_ring(), [](const ScanPoint& p) { return std::uint16_t(p.ring); });
    set(*points.mutable_time_s(), [](const ScanPoint& p) { return p.time_offset_s; });
    set(*points.mutable_instance(), [](const ScanPoint& p) { return p.instance; });
    points.mutable_return_number()->assign(scan.points.size(), 1);
    points.set_count(std::uint32_t(scan.points.size()));
}

void write_scene(const std::string& name, const Run& run, v1::Scene& message) {
    const Sequence& log = run.sequence;
    message.set_name(name);
    message.set_begin_s(log.frames.front().time_s);
    message.set_end_s(log.frames.back().time_s);
    message.set_sampled_noise(std::ranges::any_of(
        log.lidars, [](const Lidar& lidar) { return !lidar.range_noise.sigma_m.empty(); }));
    for (std::size_t i = 0; i < log.lidars.size(); ++i) {
        const Lidar& lidar = log.lidars[i];
        v1::Lidar& added = *message.add_lidars();
        added.set_name(lidar.name);
        added.set_sensor(lidar.sensor.name);
        added.set_rays(count_rays(configured_sensor(run.config, log, int(i))));
        added.set_period_s(lidar.period_s());
    }
    for (const std::string& actor : actor_names(run)) write_actor(run, actor, *message.add_actors());
}

void write_tracks(const Run& run, int lidar, const google::protobuf::RepeatedPtrField<std::string>& actors,
                  v1::GetTracksResponse& message) {
    const Sequence& log = run.sequence;
    const auto in_dataset = [&](const PoseTrack& track) { return shifted_track(track, log.world_offset_m); };
    write_track(in_dataset(log.world_from_sensor(lidar)), *message.mutable_dataset_from_sensor());
    if (std::size_t(actors.size()) > run.scene.instances.size())
        refuse("actors", fmt::format("{} names", actors.size()), "each actor once at most");
    std::vector<std::string> names(actors.begin(), actors.end());
    if (names.empty()) names = actor_names(run);
    for (const std::string& name : names) {
        const BoxTrack* box = find_box(run.sequence, name);
        if (!box)
            throw Refusal(
                grpc::StatusCode::NOT_FOUND,
                fmt::format("reading actors: found {}, expected an actor of the log that ListScenes gives",
                            quoted(name)));
        v1::ActorTrack& track = *message.add_actors();
        track.set_name(name);
        write_track(in_dataset(box->world_from_box), *track.mutable_poses());
    }
}

}  // namespace relidar::serve
