// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/channel_makers.hpp"

#include <relidar/diff/forward.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/render.hpp>

#include "base/parallel.hpp"
#include "simulate/render/points_on_device.hpp"

namespace relidar {
namespace {

constexpr float kMinObservedFraction = 0.5f;  // observed share of the path of an observed ray

bool is_unobserved(float observed_fraction) { return observed_fraction < kMinObservedFraction; }

RayWithSurfaceRange surface_ray(const RenderedScan& scan, std::size_t ray) {
    return {scan.firing_pose(ray), glm::dvec3(scan.image.origin[ray]), glm::dvec3(scan.image.direction[ray]),
            scan.median_range_m[ray]};
}

/// Returns the fraction of a ray's path that the log has observed. The path ends at the
/// surface that the ray hits, or at the maximum range.
float observed_share(const RayWithSurfaceRange& ray, const LogObservedSpace& space) {
    Pose world_from_firing = ray.dataset_from_firing;
    world_from_firing.translation -= space.world_offset_m;
    const double length_m =
        ray.met_m > 0.0f ? std::min(double(ray.met_m), space.max_range_m) : space.max_range_m;
    return static_cast<float>(space.coverage.observed_fraction(
        world_from_firing * ray.origin_m, world_from_firing * (ray.origin_m + length_m * ray.direction)));
}

/// Returns the unit normal of each surface, in the sensor's frame at the firing time.
ChannelValues make_normals(const RenderedRayValues& rendering, const RenderedScan& scan) {
    std::vector<glm::vec3> normal(rendering.size(), glm::vec3(0.0f));
    FiringPoseInterpolator firing(scan);
    for (std::size_t i = 0; i < normal.size(); ++i) {
        if (rendering.weight[i] < kMinWeight) continue;
        // rendering.normal is in the world frame
        const glm::dvec3 in_sensor =
            glm::conjugate(firing.pose_of(i).rotation) * glm::dvec3(rendering.normal[i]);
        const double length = glm::length(in_sensor);
        if (length > 0.0) normal[i] = glm::vec3(in_sensor / length);
    }
    return normal;
}

ChannelValues make_incidence(std::span<const shared::MeasuredRay> measured) {
    std::vector<float> cosine;
    for (const shared::MeasuredRay& ray : measured) cosine.push_back(ray.incidence);
    return cosine;
}

/// Returns for each ray how fast its range changes, in m/s:
///   direction * (velocity of the surface - velocity of the ray's origin)
/// In weather, add_weather() sets the values of returns from the air.
ChannelValues make_velocity(const RenderedScan& scan, const ChannelInputs& context) {
    std::vector<float> velocity(scan.median_range_m.size(), 0.0f);
    for (std::size_t i = 0; i < velocity.size(); ++i) {
        if (scan.instance[i] < 0 || !(scan.median_range_m[i] > 0.0f)) continue;
        const RayMotion ray = context.motion.motion_of_ray(scan, i);
        const glm::dvec3 surface_mps =
            context.motion.object_velocity(scan.instance[i], scan.time_offset_s[i],
                                           ray.start_m + double(scan.median_range_m[i]) * ray.direction);
        velocity[i] = float(glm::dot(ray.direction, surface_mps) - ray.sensor_away_mps);
    }
    return velocity;
}

/// Returns the class of the surface that each ray hits. For the background, looks up the
/// class at the point at the median range.
ChannelValues make_classes(const RenderedScan& scan, const ChannelInputs& context) {
    std::vector<std::int32_t> classes(scan.instance.size(), -1);  // -1: the ray hits nothing
    parallel_blocks(classes.size(), [&](std::size_t ray) {
        const std::int32_t instance = scan.instance[ray];
        if (instance < 0) return;
        classes[ray] = context.classes[std::size_t(instance)];
        if (classes[ray] != std::int32_t(SurfaceClass::unknown) || !context.background) return;
        const glm::dvec3 hit_m =
            scan.firing_pose(ray) * scan.end_of<double>(ray) - context.log.world_offset_m;
        classes[ray] = std::int32_t(context.background->find_class(hit_m));
    });
    return classes;
}

ChannelValues make_observed(const RenderedScan& scan, const ChannelInputs& context) {
    if (context.log.coverage.empty()) return {};
    std::vector<float> shares(scan.median_range_m.size());
    parallel_blocks(shares.size(), [&](std::size_t ray) {
        shares[ray] = observed_share(surface_ray(scan, ray), context.log);
    });
    return shares;
}

/// Exactly one of the three functions is set.
struct ChannelComputation {
    std::string_view name;
    ChannelValues (*of_rendering)(const RenderedRayValues&, const RenderedScan&);
    ChannelValues (*of_measured)(std::span<const shared::MeasuredRay>);
    ChannelValues (*of_scan)(const RenderedScan&, const ChannelInputs&);
};
constexpr ChannelComputation kChannelMakers[] = {
    {"normal", make_normals, nullptr, nullptr},
    {kIncidenceChannel, nullptr, make_incidence, nullptr},
    {"velocity", nullptr, nullptr, make_velocity},
    {"spread", nullptr, nullptr,
     [](const RenderedScan& scan, const ChannelInputs&) -> ChannelValues { return range_spread(scan); }},
    {"class", nullptr, nullptr, make_classes},
    {"seen", nullptr, nullptr, make_observed},
    {"surfel_drop_prob", nullptr, nullptr,
     [](const RenderedScan& scan, const ChannelInputs&) -> ChannelValues { return scan.image.drop_prob; }},
    {"source", nullptr, nullptr,
     // add_weather() overwrites the causes later.
     [](const RenderedScan& scan, const ChannelInputs&) -> ChannelValues {
         return std::vector<std::int32_t>(scan.median_range_m.size(), std::int32_t(ReturnCause::surface));
     }},
};

ChannelComputation find_maker(const ChannelInfo& channel) {
    const auto* maker = std::ranges::find(kChannelMakers, channel.name, &ChannelComputation::name);
    return maker == std::end(kChannelMakers) ? ChannelComputation{} : *maker;
}

}  // namespace

FiringPoseInterpolator::FiringPoseInterpolator(const RenderedScan& scan, const Pose& target_from_dataset)
    : scan_(scan),
      target_from_dataset_(target_from_dataset),
      moves_(scan.track.pose.size() > 1),
      cached_(moves_ && scan.image.rows > 1 ? std::size_t(scan.image.columns) : 1) {}

/// Computes a pose only if the ray fires at another time than the last ray of its column.
const Pose& FiringPoseInterpolator::pose_of(std::size_t ray) {
    std::optional<CachedFiringPose>& cached = cached_[ray % cached_.size()];  // rays are stored row by row
    const float time_offset_s = moves_ ? scan_.time_offset_s[ray] : 0.0f;
    if (!cached || cached->time_offset_s != time_offset_s)
        cached = {time_offset_s, target_from_dataset_ * scan_.firing_pose(ray)};
    return cached->target_from_firing;
}

double unobserved_share(std::size_t n_rays, const RaySource& get_ray, const LogObservedSpace& space) {
    std::vector<float> shares(n_rays);
    parallel_blocks(n_rays,
                    [&](std::size_t index) { shares[index] = observed_share(get_ray(index), space); });
    return double(std::ranges::count_if(shares, is_unobserved)) / double(n_rays);
}

void set_unseen_share(RenderedScan& scan, const LogObservedSpace& space) {
    const std::size_t n = scan.median_range_m.size();
    if (space.coverage.empty() || n == 0) return;
    if (const std::vector<float>* observed = find_values<float>(scan.channels, "seen")) {
        scan.unseen_share =
            double(std::ranges::count_if(*observed, is_unobserved)) / double(observed->size());
        return;
    }
    // Without this channel, a sample of the rays gives an estimate.
    const auto sampled_ray = [&](std::size_t sample) {
        return surface_ray(scan, DevicePointComputer::sample_ray(sample, n));
    };
    scan.unseen_share = unobserved_share(DevicePointComputer::sample_count(n), sampled_ray, space);
}

static_assert(1 + int(ObjectKind::vehicle) == int(SurfaceClass::vehicle) &&
              1 + int(ObjectKind::other) == int(SurfaceClass::other_actor));

std::vector<std::int32_t> instance_classes(const Scene& scene, const Log& log) {
    std::vector<std::int32_t> classes(scene.instances.size(), 0);
    for (std::size_t i = 0; i < classes.size(); ++i) {
        const ModelInstance& instance = scene.instances[i];
        if (instance.track.empty()) continue;  // the background
        // The log has no box for a copied actor. The name of the model, which it shares
        // with the original, is the id of the original's box.
        const BoxTrack* box = find_box(log, instance.track);
        if (!box) box = find_box(log, scene.models[instance.model].name);
        classes[i] = 1 + std::int32_t(box ? guess_kind(*box) : ObjectKind::other);
    }
    return classes;
}

bool needs_rendering(const std::vector<ChannelInfo>& channels) {
    return std::ranges::any_of(
        channels, [](const ChannelInfo& channel) { return find_maker(channel).of_rendering != nullptr; });
}

void add_ray_channels(RenderedScan& scan, std::span<const shared::MeasuredRay> measured,
                      const RenderedRayValues& values, const std::vector<ChannelInfo>& infos) {
    for (const ChannelInfo& channel : infos) {
        const ChannelComputation maker = find_maker(channel);
        if (maker.of_rendering) scan.channels.push_back({channel, maker.of_rendering(values, scan)});
        if (maker.of_measured) scan.channels.push_back({channel, maker.of_measured(measured)});
    }
}

void add_beam_channels(RenderedScan& scan, const ChannelInputs& in, const std::vector<ChannelInfo>& infos) {
    for (const ChannelInfo& channel : infos) {
        const ChannelComputation maker = find_maker(channel);
        if (!maker.of_scan) continue;
        ChannelValues values = maker.of_scan(scan, in);
        if (count_values(values) == scan.image.range_m.size())
            scan.channels.push_back({channel, std::move(values)});
    }
}

}  // namespace relidar
