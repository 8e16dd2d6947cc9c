// SPDX-License-Identifier: Apache-2.0

#include "base/fail.hpp"
#include "simulate/channels/channel_pairs.hpp"

namespace relidar {
namespace {

template <class T>
void append_elements(std::vector<T>& target, const std::vector<T>& source) {
    target.insert(target.end(), source.begin(), source.end());
}

/// Adds the channels of a scan to the merged scan. The rays that are already merged have
/// no values in a new channel.
/// @throws UsageError if a channel has a different type in two scans
void add_channels(RenderedScan& merged, const RenderedScan& scan) {
    for (const ScanChannel& channel : copy_layout(scan.channels)) {
        const ScanChannel* known = find_channel(merged, channel.info.name);
        if (!known) {
            merged.channels.push_back(channel);
            std::visit(
                [&]<class T>(std::vector<T>& values) {
                    values.assign(merged.image.range_m.size(), empty_value<T>(channel.info));
                },
                merged.channels.back().values);
        } else if (known->values.index() != channel.values.index()) {
            fail<UsageError>("cannot merge scans: the channel {} has different types in two scans",
                             channel.info.name);
        }
    }
}

/// Appends the values that a channel of a scan has for second returns. The rays before
/// this scan get the empty value if their scans have no such values.
/// @param first_ray index of the scan's first ray in the merged scan
void append_second(ScanChannel& merged, const ScanChannel& source, std::size_t first_ray) {
    const auto add = [&]<class T>(const std::vector<T>& values) {
        if (count_values(merged.second) == 0) merged.second = std::vector<T>{};
        auto& all = std::get<std::vector<T>>(merged.second);
        all.resize(first_ray, empty_value<T>(merged.info));
        append_elements(all, values);
    };
    std::visit(add, source.second);
}

/// Combines the poses of a sensor rig (`rig_scan`) with the firing times of one of its
/// sensors (`sensor_scan`). Used to interpolate the rig's pose at each firing time.
RenderedScan rig_at_firing_times(const RenderedScan& rig_scan, const RenderedScan& sensor_scan) {
    RenderedScan rig;
    rig.image.rows = sensor_scan.image.rows;
    rig.image.columns = sensor_scan.image.columns;
    rig.time_offset_s = sensor_scan.time_offset_s;
    rig.time_s = rig_scan.time_s;
    rig.track = rig_scan.track;
    rig.world_from_sensor = rig_scan.world_from_sensor;
    return rig;
}

/// Poses of rig and sensor are interpolated separately, so the pose of the sensor
/// relative to the rig is not exactly constant.
class RigPoses {
public:
    /// @param scan must outlive this object
    RigPoses(const RenderedScan& merged, const RenderedScan& scan)
        : rig_(rig_at_firing_times(merged, scan)), world_from_rig_(rig_), world_from_firing_(scan) {}
    RigPoses(const RigPoses&) = delete;
    RigPoses& operator=(const RigPoses&) = delete;
    Pose pose_in_rig(std::size_t ray) {
        return inverse(world_from_rig_.pose_of(ray)) * world_from_firing_.pose_of(ray);
    }

private:
    const RenderedScan rig_;
    FiringPoseInterpolator world_from_rig_, world_from_firing_;
};

/// Appends the values of a scan to all channels of the merged scan. If the scan lacks a
/// channel, its rays get the empty value.
/// @param first_ray index of the scan's first ray in the merged scan
void append_channels(RenderedScan& merged, const RenderedScan& scan, RigPoses& rig, std::size_t first_ray) {
    const std::size_t n_rays = scan.image.range_m.size();
    for (ScanChannel& channel : merged.channels) {
        const ScanChannel* source = find_channel(scan, channel.info.name);
        const auto append_values = [&]<class T>(std::vector<T>& values) {
            if (source) append_elements(values, std::get<std::vector<T>>(source->values));
            else values.resize(first_ray + n_rays, empty_value<T>(channel.info));
        };
        std::visit(append_values, channel.values);
        if (!source) continue;
        // Rotates vectors, such as normals, into the frame of the rig.
        auto* vectors = std::get_if<std::vector<glm::vec3>>(&channel.values);
        for (std::size_t i = 0; vectors && channel.info.turns && i < n_rays; ++i) {
            glm::vec3& vector = (*vectors)[first_ray + i];
            vector = glm::vec3(rig.pose_in_rig(i).rotation * glm::dvec3(vector));
        }
        if (count_values(source->second) > 0) append_second(channel, *source, first_ray);
    }
}

/// Extends the lists of second returns to the last ray, because so far they end with the
/// last scan that has second returns. Added entries mean no return: range and intensity
/// are 0, channels have their empty value. A channel without second values keeps none.
void pad_second_returns(RenderedScan& merged) {
    const std::size_t n_rays = merged.image.range_m.size();
    for (AdditionalReturns& second : merged.second_returns) {
        second.range_m.resize(n_rays);
        second.intensity.resize(n_rays);
    }
    for (ScanChannel& channel : merged.channels)
        if (count_values(channel.second) > 0)
            std::visit(
                [&]<class T>(std::vector<T>& values) { values.resize(n_rays, empty_value<T>(channel.info)); },
                channel.second);
}

/// Adds the ray counts of a scan to the merged scan: rays per actor, and rays per
/// unobserved side of an actor.
void merge_counts(RenderedScan& merged, const RenderedScan& scan) {
    for (const ActorVisibility& view : scan.actor_views) {
        const auto known = std::ranges::find(merged.actor_views, view.track, &ActorVisibility::track);
        if (known == merged.actor_views.end()) merged.actor_views.push_back(view);
        else {
            known->n_rays += view.n_rays;
            known->n_rays_alone += view.n_rays_alone;
        }
    }
    for (const UnobservedActorSide& side : scan.unseen_sides) {
        const auto known = std::ranges::find_if(merged.unseen_sides, [&](const UnobservedActorSide& other) {
            return other.track == side.track && other.side == side.side &&
                   other.is_completed == side.is_completed;
        });
        if (known == merged.unseen_sides.end()) merged.unseen_sides.push_back(side);
        else known->n_rays += side.n_rays;
    }
}

/// Appends the rays of a scan to the merged scan. Each ray is transformed into the frame
/// of the rig at the firing time of the ray.
/// @param ring number of this scan's ring 0 in the merged scan
void append_rays(RenderedScan& merged, const RenderedScan& scan, RigPoses& rig, std::size_t ring) {
    for (std::size_t i = 0; i < scan.image.origin.size(); ++i) {
        merged.time_offset_s.push_back(scan.time_offset_s[i]);
        merged.ring.push_back(static_cast<std::uint16_t>(ring + scan.ring[i]));
        const Pose rig_from_firing = rig.pose_in_rig(i);
        merged.image.origin.emplace_back(rig_from_firing * glm::dvec3(scan.image.origin[i]));
        merged.image.direction.emplace_back(
            glm::normalize(rig_from_firing.rotation * glm::dvec3(scan.image.direction[i])));
    }
}

}  // namespace

RenderedScan merge_scans(const std::vector<RenderedScan>& scans, const std::vector<Pose>& rig_from_sensor) {
    if (scans.empty() || scans.size() != rig_from_sensor.size())
        fail<UsageError>("cannot merge {} scans: found the poses of {} sensors", scans.size(),
                         rig_from_sensor.size());
    RenderedScan merged;
    const Pose sensor_from_rig = inverse(rig_from_sensor[0]);
    merged.world_from_sensor = scans[0].world_from_sensor * sensor_from_rig;
    merged.track = mount_track(scans[0].track, sensor_from_rig);
    merged.time_s = scans[0].time_s;
    std::size_t n_rings = 0;   // of the scans before: numbers of the next scan start here
    double unseen_rays = 0.0;  // rays in space that the log has not observed
    for (const RenderedScan& scan : scans) {
        check_channels(scan.channels, scan.image.range_m.size(), "a scan of a rig");
        add_channels(merged, scan);
        RigPoses poses(merged, scan);
        append_rays(merged, scan, poses, n_rings);
        if (!scan.ring.empty()) n_rings += std::size_t(*std::ranges::max_element(scan.ring)) + 1;
        // Ring numbers are stored in 16 bits.
        if (n_rings > 65536)
            fail<UsageError>("cannot merge scans: found {} beams in total, expected at most 65536", n_rings);
        const std::size_t first_ray = merged.image.range_m.size();
        append_channels(merged, scan, poses, first_ray);
        for_basic_channels(scan, merged,
                           [](const ChannelInfo&, const auto& from, auto& to) { append_elements(to, from); });
        if (scan.unseen_share) {
            unseen_rays += *scan.unseen_share * double(scan.instance.size());
            merged.unseen_share = unseen_rays / double(merged.instance.size());
        }
        merged.second_returns.resize(std::max(merged.second_returns.size(), scan.second_returns.size()));
        for (std::size_t k = 0; k < scan.second_returns.size(); ++k) {
            merged.second_returns[k].range_m.resize(first_ray);
            merged.second_returns[k].intensity.resize(first_ray);
            append_elements(merged.second_returns[k].range_m, scan.second_returns[k].range_m);
            append_elements(merged.second_returns[k].intensity, scan.second_returns[k].intensity);
        }
        merge_counts(merged, scan);
        merged.trace_ms += scan.trace_ms;
    }
    pad_second_returns(merged);
    merged.image.rows = 1;
    merged.image.columns = static_cast<int>(merged.image.range_m.size());
    return merged;
}

}  // namespace relidar
