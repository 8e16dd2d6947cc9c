// SPDX-License-Identifier: Apache-2.0
// Aligns one scan with a fixed scene. Compares each point with the rendered surface on
// the same ray, so it needs no search for corresponding points.
#include <relidar/registration/registration.hpp>

#include "base/parallel.hpp"
#include "registration/plane_adjustment.hpp"
#include "registration/pose_equations.hpp"

namespace relidar {
namespace {

// Edge length in metres of grid cells; one point of the scan per cell is used. The cells
// are small, because only one pose is estimated and speed does not matter.
constexpr double kThinningCell_m = 0.1;
constexpr double kKernelScale_m = 0.05;    // at this distance from the surface, a point has a weight of 1/4
constexpr double kConvergedStep_m = 2e-4;  // stops the iteration if a step is shorter than this
constexpr int kMaxAlignmentSteps = 8;

/// Selected rays of one frame, and their returns.
struct FrameRays {
    int frame_index;  ///< in Log::frames
    std::vector<std::size_t> rays;
    std::vector<SubsampledPoint> points;
};

/// Selects returns from the frames of all LiDARs that swept at the time of a pose.
/// @param pose index into Log::world_from_vehicle
std::vector<FrameRays> rays_at_pose(const Log& log, std::size_t pose, const RegistrationOptions& options) {
    std::vector<FrameRays> frames;
    for (int i = 0; i < static_cast<int>(log.frames.size()); ++i) {
        if (log.frames[std::size_t(i)].time_s != log.world_from_vehicle.time_s[pose]) continue;  // exact
        FrameRays selected{
            .frame_index = i, .rays = select_returns(log, i, options, kThinningCell_m), .points = {}};
        if (selected.rays.empty()) continue;
        selected.points.resize(selected.rays.size());
        parallel_blocks(selected.rays.size(), [&](std::size_t k) {
            selected.points[k] = make_point(log, log.world_from_vehicle, pose, i, selected.rays[k]);
        });
        frames.push_back(std::move(selected));
    }
    return frames;
}

}  // namespace

ScanAlignment align_scan(const Log& log, std::size_t pose_index, const SceneCaster& scene_view,
                         const std::vector<UnobservedMotion>& unobserved,
                         const RegistrationOptions& options) {
    PoseTrack track = log.world_from_vehicle;
    const Pose initial_pose = track.pose[pose_index];
    ScanAlignment result{.world_from_vehicle = initial_pose};  // not aligned yet
    const std::vector<FrameRays> frames = rays_at_pose(log, pose_index, options);
    std::size_t n_rays = 0;
    for (const FrameRays& frame : frames) n_rays += frame.rays.size();
    if (n_rays == 0) return result;
    // Starts above the limit, so that the loop runs at least once.
    double step_m = 2.0 * kConvergedStep_m;
    for (int i = 0; i < kMaxAlignmentSteps && step_m > kConvergedStep_m; ++i) {
        SinglePoseEquations equations;
        for (const FrameRays& frame : frames) {
            // Rays are cast again after each step, because they then hit other surfaces.
            const std::vector<SurfaceHit> surfaces = scene_view(frame.frame_index, frame.rays, track);
            equations += sum_point_equations(surfaces.size(), [&](SinglePoseEquations& sum, std::size_t k) {
                if (surfaces[k].normal == glm::dvec3(0.0)) return;  // The ray hits no surface.
                const LocalPlane plane{.point_m = surfaces[k].point_m, .normal = surfaces[k].normal};
                sum.add_residual(make_residual(point_to_world(track, frame.points[k]), plane, kKernelScale_m),
                                 weight_of_pose(frame.points[k], pose_index));
            });
        }
        result.on_surfaces = double(equations.count_on_planes()) / double(n_rays);
        if (equations.empty()) return result;
        step_m = equations.move_pose(track.pose[pose_index], initial_pose, unobserved);
    }
    const double moved_m = glm::distance(initial_pose.translation, track.pose[pose_index].translation);
    if (!PoseAdjustment::has_enough_planes(result.on_surfaces, n_rays) || moved_m > options.largest_m)
        return result;
    return {.world_from_vehicle = track.pose[pose_index],
            .moved_m = moved_m,
            .on_surfaces = result.on_surfaces,
            .is_aligned = true};
}

}  // namespace relidar
