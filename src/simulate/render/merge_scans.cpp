// SPDX-License-Identifier: Apache-2.0
#include <relidar/simulate/render.hpp>

#include <algorithm>
#include <type_traits>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "simulate/render/channel_pairs.hpp"

namespace relidar {
namespace {

template <class T>
void append(std::vector<T>& target, const std::vector<T>& source) {
    target.insert(target.end(), source.begin(), source.end());
}

/// Adds the channels of a scan to the merged scan. If a channel is new, it gets no value
/// for the rays that are already merged.
/// @throws UsageError if a channel has a different type in two scans
void add_channels(RenderedScan& merged, const RenderedScan& scan) {
    for (const ScanChannel& channel : copy_without_values(scan.channels)) {
        const auto known =
            std::ranges::find(merged.channels, channel.info.name,
                              [](const ScanChannel& c) -> const std::string& { return c.info.name; });
        if (known == merged.channels.end()) {
            merged.channels.push_back(channel);
            std::visit(
                [&]<class T>(std::vector<T>& values) {
                    values.assign(merged.image.range_m.size(), get_missing_value<T>(channel.info));
                },
                merged.channels.back().values);
        } else if (known->values.index() != channel.values.index()) {
            throw UsageError(fmt::format(
                "cannot merge scans: the channel {} has different types in two scans", channel.info.name));
        }
    }
}

/// Appends the values that a channel has for second returns.
void append_second_returns(ScanChannel& merged, const ScanChannel& source_channel, std::size_t first_ray) {
    const auto add = [&]<class T>(const std::vector<T>& values) {
        if (size(merged.second) == 0) merged.second = std::vector<T>{};
        auto& all = std::get<std::vector<T>>(merged.second);
        all.resize(first_ray, get_missing_value<T>(merged.info));
        append(all, values);
    };
    std::visit(add, source_channel.second);
}

/// Returns a scan with the poses of the rig (all merged sensors) and the firing times of
/// one sensor.
RenderedScan make_rig_sweep(const RenderedScan& merged, const RenderedScan& scan) {
    RenderedScan rig;
    rig.image.rows = scan.image.rows;
    rig.image.columns = scan.image.columns;
    rig.time_offset_s = scan.time_offset_s;
    rig.time_s = merged.time_s;
    rig.track = merged.track;
    rig.world_from_sensor = merged.world_from_sensor;
    return rig;
}

/// Computes the pose of a sensor in the rig's frame at the firing time of a ray.
/// Interpolates the poses of sensor and rig separately. A fixed mounting pose would be
/// slightly wrong, because the interpolated positions move along different straight
/// lines.
class RigPoses {
public:
    /// Copies the tracks of the rig, and keeps a reference to the scan of the sensor.
    /// @param scan scan of the sensor; must outlive this object
    RigPoses(const RenderedScan& merged, const RenderedScan& scan)
        : rig_(make_rig_sweep(merged, scan)), world_from_rig_(rig_), world_from_firing_(scan) {}
    RigPoses(const RigPoses&) = delete;
    RigPoses& operator=(const RigPoses&) = delete;
    Pose get_rig_from_firing(std::size_t ray) {
        return inverse(world_from_rig_.at(ray)) * world_from_firing_.at(ray);
    }

private:
    const RenderedScan rig_;
    FiringPoses world_from_rig_, world_from_firing_;
};

/// Appends the values of all channels of a scan.
/// @param first_ray index of the scan's first ray in the merged scan
void append_scan_channels(RenderedScan& merged, const RenderedScan& scan, RigPoses& poses,
                          std::size_t first_ray) {
    const std::size_t n = scan.image.range_m.size();
    for (ScanChannel& channel : merged.channels) {
        // Copies the reference, because clang 14 cannot capture structured bindings in a
        // lambda.
        const ChannelInfo& info = channel.info;
        const auto add = [&]<class T>(std::vector<T>& all) {
            const std::vector<T>* own = find_values<T>(scan.channels, info.name);
            for (std::size_t i = 0; i < n; ++i) all.push_back(own ? (*own)[i] : get_missing_value<T>(info));
            if constexpr (std::is_same_v<T, glm::vec3>)
                for (std::size_t i = 0; own && info.turns && i < n; ++i)
                    all[first_ray + i] =
                        glm::vec3(poses.get_rig_from_firing(i).rotation * glm::dvec3((*own)[i]));
        };
        std::visit(add, channel.values);
        for (const ScanChannel& own : scan.channels)
            if (own.info.name == info.name && size(own.second) > 0)
                append_second_returns(channel, own, first_ray);
    }
}

/// Fills up the lists of second returns for rays without a second return. Their ranges
/// and intensities are 0, and their channels have no value.
void fill_second_returns(RenderedScan& merged) {
    const std::size_t n = merged.image.range_m.size();
    for (SecondReturn& second : merged.second_returns) second.range_m.resize(n), second.intensity.resize(n);
    for (ScanChannel& channel : merged.channels)
        if (size(channel.second) > 0)
            std::visit([&]<class T>(std::vector<T>& v) { v.resize(n, get_missing_value<T>(channel.info)); },
                       channel.second);
}

/// Adds the numbers of rays that hit the actors and their unobserved sides to the numbers
/// of the merged scan.
void add_actors(RenderedScan& merged, const RenderedScan& scan) {
    for (const ActorView& view : scan.actor_views) {
        const auto known = std::ranges::find(merged.actor_views, view.track, &ActorView::track);
        if (known == merged.actor_views.end()) merged.actor_views.push_back(view);
        else known->n_rays += view.n_rays, known->n_rays_alone += view.n_rays_alone;
    }
    for (const UnseenSide& side : scan.unseen_sides) {
        const auto known = std::ranges::find_if(merged.unseen_sides, [&](const UnseenSide& other) {
            return other.track == side.track && other.side == side.side &&
                   other.is_completed == side.is_completed;
        });
        if (known == merged.unseen_sides.end()) merged.unseen_sides.push_back(side);
        else known->n_rays += side.n_rays;
    }
}

/// Appends the rays of a scan to the merged scan. Each ray is transformed into the frame
/// of the rig at the firing time of the ray.
/// @param first_ring number of this scan's ring 0 in the merged scan
void append_rays(RenderedScan& merged, const RenderedScan& scan, RigPoses& poses, std::size_t first_ring) {
    for (std::size_t i = 0; i < scan.image.origin.size(); ++i) {
        merged.time_offset_s.push_back(scan.time_offset_s[i]);
        merged.ring.push_back(static_cast<std::uint16_t>(first_ring + scan.ring[i]));
        const Pose rig_from_firing = poses.get_rig_from_firing(i);
        merged.image.origin.emplace_back(rig_from_firing * glm::dvec3(scan.image.origin[i]));
        merged.image.direction.emplace_back(
            glm::normalize(rig_from_firing.rotation * glm::dvec3(scan.image.direction[i])));
    }
}

}  // namespace

RenderedScan merge_scans(const std::vector<RenderedScan>& scans, const std::vector<Pose>& rig_from_sensor) {
    if (scans.empty() || scans.size() != rig_from_sensor.size())
        throw UsageError(fmt::format(
            "cannot merge scans: found {} scans and {} mountings, expected the same number of both",
            scans.size(), rig_from_sensor.size()));
    RenderedScan merged;
    const Pose sensor_from_rig = inverse(rig_from_sensor[0]);
    merged.world_from_sensor = scans[0].world_from_sensor * sensor_from_rig;
    merged.track = mount_on_track(scans[0].track, sensor_from_rig);
    merged.time_s = scans[0].time_s;
    std::size_t rings = 0;
    double unseen_rays = 0.0;
    for (const RenderedScan& scan : scans) {
        check_channels(scan.channels, scan.image.range_m.size(), "a scan of a rig");
        add_channels(merged, scan);
        RigPoses poses(merged, scan);
        append_rays(merged, scan, poses, rings);
        if (!scan.ring.empty()) rings += std::size_t(*std::ranges::max_element(scan.ring)) + 1;
        if (rings > 65536)
            throw UsageError(
                fmt::format("cannot merge scans: found {} beams in total, expected at most 65536", rings));
        const std::size_t first_ray = merged.image.range_m.size();
        append_scan_channels(merged, scan, poses, first_ray);
        for_each_basic_pair(scan, merged,
                            [](const ChannelInfo&, const auto& from, auto& to) { append(to, from); });
        if (scan.unseen_share) {
            unseen_rays += *scan.unseen_share * double(scan.instance.size());
            merged.unseen_share = unseen_rays / double(merged.instance.size());
        }
        merged.second_returns.resize(std::max(merged.second_returns.size(), scan.second_returns.size()));
        for (std::size_t k = 0; k < scan.second_returns.size(); ++k) {
            merged.second_returns[k].range_m.resize(first_ray),
                merged.second_returns[k].intensity.resize(first_ray);
            append(merged.second_returns[k].range_m, scan.second_returns[k].range_m);
            append(merged.second_returns[k].intensity, scan.second_returns[k].intensity);
        }
        add_actors(merged, scan);
        merged.trace_ms += scan.trace_ms;
    }
    fill_second_returns(merged);
    merged.image.rows = 1;
    merged.image.columns = static_cast<int>(merged.image.range_m.size());
    return merged;
}

}  // namespace relidar
