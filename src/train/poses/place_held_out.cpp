// SPDX-License-Identifier: Apache-2.0
// Aligns held-out scans with the trained scene, so that metrics have no pose errors.
#include <relidar/train/train.hpp>

#include <algorithm>
#include <set>

#include <relidar/log/channels.hpp>
#include <relidar/registration/registration.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "train/poses/register_options.hpp"

namespace relidar {
namespace {

constexpr float kFewestWeight = 0.5f;  // minimum blending weight of a ray that hits a solid surface

/// Returns the settings for rendering the surfaces of a scene.
Config surface_config(Config config) {
    config.render.channels = "normal";
    config.sensor.sub_rays = config.sensor.returns = 1;
    return config;
}

/// Returns the surface point and normal that the trained background shows along each ray,
/// in the world frame of the log. An entry stays empty if the ray hits no surface, or an
/// actor, because the poses of actors are only estimates.
std::vector<SurfaceHit> render_surfaces(ScanRenderer& renderer, const Run& run, int frame_index,
                                        const std::vector<std::size_t>& ray_indices,
                                        const PoseTrack& world_from_vehicle) {
    const Frame& frame = run.log.frames[std::size_t(frame_index)];
    SimulatedSensor sensor;
    sensor.rays = select_rays(frame.scan.rays, ray_indices);
    sensor.follows_sweeps = false;
    sensor.lidar = frame.lidar;
    sensor.rolling_shutter = run.log.rolling_shutter;
    const PoseTrack world_from_sensor =
        mount_track(world_from_vehicle, run.log.lidar_of(frame).vehicle_from_sensor);
    // The renderer uses the world frame of the dataset, and the log that minus offset_m.
    const glm::dvec3& offset_m = run.log.world_offset_m;
    const RenderedScan scan =
        renderer.render(sensor, {frame.time_s, shift_track(world_from_sensor, offset_m), {}});
    const std::vector<glm::vec3>& normals = *find_values<glm::vec3>(scan.channels, "normal");
    std::vector<SurfaceHit> surfaces(ray_indices.size());
    FiringPoseInterpolator firing(scan);
    for (std::size_t i = 0; i < ray_indices.size(); ++i) {
        const std::int32_t instance = scan.instance[i];  // negative: none
        if (scan.weight[i] < kFewestWeight || instance < 0) continue;
        const bool is_actor = !run.scene.instances[std::size_t(instance)].track.empty();
        if (is_actor) continue;
        const Pose& pose = firing.pose_of(i);
        surfaces[i] = {pose * glm::dvec3(scan.end_of(i)) - offset_m, pose.rotation * glm::dvec3(normals[i])};
    }
    return surfaces;
}

}  // namespace

HeldOutPoseReport register_held_out(Device& device, Run& run, const ScanCallbacks& session) {
    HeldOutPoseReport result;
    const Config& config = run.config;
    if (!config.train.place_held_out || !registers_sensors(config.train) ||
        !properties_of(config.image.primitive).has_normals) {
        run.held_out_placed = true;
        return result;
    }
    const RegistrationOptions options = registration_options(run.log, config);
    ScanRenderer renderer(device, run.scene, surface_config(config), run.log);
    const std::vector<std::vector<UnobservedMotion>> unobserved =
        find_unobserved_motions(run.log, run.split.train, options);
    PoseTrack track = run.log.world_from_vehicle;
    std::vector<double> moved_m;
    // Indices of the vehicle poses of the held-out sweeps. LiDARs that sweep at the same
    // time have the same pose, so their scans are aligned together.
    std::set<std::size_t> poses;
    for (const int position : run.split.test)
        poses.insert(run.log.find_pose_index(run.log.frames[std::size_t(position)]));
    for (const std::size_t pose : poses) {
        if (session.progress)
            session.progress("aligning held-out scans", double(result.scans) / double(poses.size()));
        if (session.stop && session.stop()) return {};
        const ScanAlignment placed = align_scan(
            run.log, pose,
            [&](int position, const std::vector<std::size_t>& rays, const PoseTrack& from) {
                return render_surfaces(renderer, run, position, rays, from);
            },
            unobserved[pose], options);
        ++result.scans;
        if (!placed.is_aligned) continue;
        track.pose[pose] = placed.world_from_vehicle;
        moved_m.push_back(placed.moved_m);
    }
    if (session.progress) session.progress("aligning held-out scans", 1.0);
    run.log.world_from_vehicle = std::move(track);
    run.held_out_placed = true;
    result.placed = moved_m.size();
    if (moved_m.empty()) return result;
    std::sort(moved_m.begin(), moved_m.end());
    result.median_m = moved_m[moved_m.size() / 2];
    result.largest_m = moved_m.back();
    return result;
}

}  // namespace relidar
