// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/channel_makers.hpp"

#include <algorithm>
#include <string_view>

#include <relidar/diff/forward.hpp>
#include <relidar/simulate/weather.hpp>
#include "base/parallel.hpp"

namespace relidar {
namespace {

/// Returns the unit normal of the surface that each ray hit. The normal is in the
/// sensor's frame at the firing time of the ray.
std::vector<glm::vec3> compute_visible_normals(const Rendering& rendering, const RenderedScan& scan) {
    std::vector<glm::vec3> normal(rendering.size(), glm::vec3(0.0f));
    FiringPoses firing(scan);
    for (std::size_t i = 0; i < normal.size(); ++i) {
        if (rendering.weight[i] < kMinWeight) continue;
        const glm::dvec3 in_sensor = glm::conjugate(firing.at(i).rotation) * glm::dvec3(rendering.normal[i]);
        const double length = glm::length(in_sensor);
        if (length > 0.0) normal[i] = glm::vec3(in_sensor / length);
    }
    return normal;
}

ChannelValues make_normal_channel(const Rendering& rendering, const RenderedScan& scan) {
    return compute_visible_normals(rendering, scan);
}

ChannelValues make_incidence_channel(std::span<const shared::MeasuredRay> measured) {
    std::vector<float> cosine;
    for (const shared::MeasuredRay& ray : measured) cosine.push_back(ray.incidence);
    return cosine;
}

ChannelValues make_spread_channel(const RenderedScan& scan, const ScanContext&) {
    return compute_range_spread(scan);
}

/// Returns the velocity of a point on an instance, in the world frame. The motion of the
/// limbs of a walking actor is ignored.
glm::dvec3 compute_surface_velocity(const InstancePose& placed, double after_s, const glm::dvec3& point_m) {
    const glm::dvec3 middle_m = placed.motion.at(placed.world_from_model, after_s).translation;
    return placed.motion.velocity_mps + glm::cross(placed.motion.turn_radps, point_m - middle_m);
}

/// Returns the rate of change of each ray's range:
///   direction * (velocity of the surface - velocity of the ray's origin)
/// The rotation of the LiDAR's head does not count as a motion of the sensor.
ChannelValues make_velocity_channel(const RenderedScan& scan, const ScanContext& context) {
    constexpr double kStep_s = 0.005;
    std::vector<float> velocity(scan.median_range_m.size(), 0.0f);
    const PoseTrack& track = context.world_from_sensor;
    for (std::size_t i = 0; i < velocity.size(); ++i) {
        if (scan.instance[i] < 0 || !(scan.median_range_m[i] > 0.0f)) continue;
        const double after_s = scan.time_offset_s[i], time_s = scan.time_s + after_s;
        const Pose world_from_firing = track.at(time_s);
        const glm::dvec3 origin_m(scan.image.origin[i]);
        const glm::dvec3 direction = world_from_firing.rotation * glm::dvec3(scan.image.direction[i]);
        const glm::dvec3 start_m = world_from_firing * origin_m;
        glm::dvec3 sensor_mps{0.0}, surface_mps{0.0};
        if (track.pose.size() > 1)
            sensor_mps = (track.at(time_s + kStep_s) * origin_m - track.at(time_s - kStep_s) * origin_m) /
                         (2.0 * kStep_s);
        if (std::size_t(scan.instance[i]) < context.placed.size())
            surface_mps = compute_surface_velocity(context.placed[std::size_t(scan.instance[i])], after_s,
                                                   start_m + double(scan.median_range_m[i]) * direction);
        velocity[i] = float(glm::dot(direction, surface_mps - sensor_mps));
    }
    return velocity;
}

/// Returns the class of the surface that each ray hits. The class of the background is
/// the class of the place at the median range.
ChannelValues make_class_channel(const RenderedScan& scan, const ScanContext& context) {
    std::vector<std::int32_t> of_rays(scan.instance.size(), -1);
    for_each_block(of_rays.size(), [&](std::size_t ray) {
        const std::int32_t instance = scan.instance[ray];
        if (instance < 0) return;
        of_rays[ray] = context.classes[std::size_t(instance)];
        if (of_rays[ray] != 0 || !context.background) return;
        const glm::dvec3 point_m = glm::dvec3(scan.image.origin[ray]) +
                                   double(scan.median_range_m[ray]) * glm::dvec3(scan.image.direction[ray]);
        of_rays[ray] = std::int32_t(
            context.background->find(scan.get_firing_pose(ray) * point_m - context.log.world_offset_m));
    });
    return of_rays;
}

ChannelValues make_seen_channel(const RenderedScan& scan, const ScanContext& context) {
    const SeenByLog& log = context.log;
    if (log.coverage.empty()) return {};
    std::vector<std::size_t> rays;
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i) rays.push_back(i);
    return compute_seen_shares(scan, rays, log);
}

// Returns "surface" as the cause of each return. If the scan has weather, add_weather()
// overwrites these values later.
ChannelValues make_source_channel(const RenderedScan& scan, const ScanContext&) {
    return std::vector<std::int32_t>(scan.median_range_m.size(), std::int32_t(PointSource::surface));
}

ChannelValues make_surfel_drop_channel(const RenderedScan& scan, const ScanContext&) {
    return scan.image.drop_prob;
}

/// Describes how an optional channel is computed. Exactly one of the three functions is
/// set.
struct Maker {
    std::string_view name;
    ChannelValues (*of_rendering)(const Rendering&, const RenderedScan&);
    ChannelValues (*of_measured)(std::span<const shared::MeasuredRay>);
    ChannelValues (*of_scan)(const RenderedScan&, const ScanContext&);
};
constexpr Maker kMakers[] = {
    {"normal", make_normal_channel, nullptr, nullptr},
    {kIncidence, nullptr, make_incidence_channel, nullptr},
    {"velocity", nullptr, nullptr, make_velocity_channel},
    {"spread", nullptr, nullptr, make_spread_channel},
    {"class", nullptr, nullptr, make_class_channel},
    {"seen", nullptr, nullptr, make_seen_channel},
    {"surfel_drop_prob", nullptr, nullptr, make_surfel_drop_channel},
    {"source", nullptr, nullptr, make_source_channel},
};

Maker find_channel_maker(const ChannelInfo& channel) {
    const auto* maker = std::ranges::find(kMakers, channel.name, &Maker::name);
    // A channel without a row in the table gets no values. A test
    // (tests/simulate/render/channels_test.cpp) checks that every channel has a row.
    return maker == std::end(kMakers) ? Maker{} : *maker;
}

}  // namespace

static_assert(1 + int(ObjectKind::vehicle) == int(SurfaceClass::vehicle) &&
              1 + int(ObjectKind::other) == int(SurfaceClass::other_actor));

std::vector<std::int32_t> compute_instance_classes(const Scene& scene, const Sequence& sequence) {
    std::vector<std::int32_t> classes;
    for (const Instance& instance : scene.instances) {
        // A copied actor has no box of its own, but its model has the name of the
        // original actor's box.
        const BoxTrack* box = find_box(sequence, instance.track);
        if (!box) box = find_box(sequence, scene.models[instance.model].name);
        const ObjectKind kind = box ? parse_object_kind(box->category) : ObjectKind::other;
        classes.push_back(instance.track.empty() ? 0 : 1 + std::int32_t(kind));
    }
    return classes;
}

bool needs_rendering(const std::vector<ChannelInfo>& channels) {
    return std::ranges::any_of(channels, [](const ChannelInfo& channel) {
        return find_channel_maker(channel).of_rendering != nullptr;
    });
}

void add_ray_channels(RenderedScan& scan, std::span<const shared::MeasuredRay> measured,
                      const Rendering& rendering, const std::vector<ChannelInfo>& channels) {
    for (const ChannelInfo& channel : channels) {
        const Maker maker = find_channel_maker(channel);
        if (maker.of_rendering) scan.channels.push_back({channel, maker.of_rendering(rendering, scan)});
        if (maker.of_measured) scan.channels.push_back({channel, maker.of_measured(measured)});
    }
}

void add_scan_channels(RenderedScan& scan, const ScanContext& context,
                       const std::vector<ChannelInfo>& channels) {
    for (const ChannelInfo& channel : channels) {
        const Maker maker = find_channel_maker(channel);
        if (!maker.of_scan) continue;
        ChannelValues values = maker.of_scan(scan, context);
        if (size(values) == scan.image.range_m.size()) scan.channels.push_back({channel, std::move(values)});
    }
}

}  // namespace relidar
