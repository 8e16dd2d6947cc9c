// SPDX-License-Identifier: Apache-2.0
// Aligns one scan with a fixed scene. Compares each point with the rendered surface along
// the same ray, so no search for corresponding points is needed.
#include <relidar/log/registration.hpp>

#include "base/parallel.hpp"
#include "log/registration/plane_adjustment.hpp"
#include "log/registration/pose_equations.hpp"

namespace relidar {
namespace {

// Edge length in metres of the cells that thin out a scan: one point per cell is kept.
// The cells are small, because only one pose is estimated and speed does not matter.
constexpr double kThin_m = 0.1;
// Points farther than this from the scene have little weight (scale of the robust
// kernel). A registered scan is closer.
constexpr double kScale_m = 0.05;
// Weight of the prior that pulls the pose to its start value, relative to the mean weight
// of the points.
constexpr double kPlacePrior = 1e-4;
constexpr double kPlaceStep_m = 2e-4;  // stops the iteration if a step is shorter than this
constexpr int kMostPlaceSteps = 8;

/// Selected rays of one frame, and their returns.
struct FrameRays {
    int position;
    std::vector<std::size_t> rays;
    std::vector<ThinPoint> points;
};

std::vector<FrameRays> list_rays_at(const Sequence& sequence, std::size_t pose,
                                    const RegisterOptions& options) {
    std::vector<FrameRays> frames;
    for (std::size_t i = 0; i < sequence.frames.size(); ++i)
        if (sequence.frames[i].time_s == sequence.world_from_vehicle.time_s[pose])
            frames.push_back(
                {static_cast<int>(i), thin_rays(sequence, static_cast<int>(i), options, kThin_m), {}});
    std::erase_if(frames, [](const FrameRays& f) { return f.rays.empty(); });
    for (FrameRays& f : frames) {
        f.points.resize(f.rays.size());
        for_each_block(f.rays.size(), [&](std::size_t index) {
            f.points[index] =
                make_thin_point(sequence, sequence.world_from_vehicle, pose, f.position, f.rays[index]);
        });
    }
    return frames;
}

}  // namespace

ScanPlacement place_scan(const Sequence& sequence, std::size_t pose, const SceneView& view,
                         const RegisterOptions& options) {
    PoseTrack track = sequence.world_from_vehicle;
    const Pose before = track.pose[pose];
    ScanPlacement result{before, 0.0, 0.0, false};
    const std::vector<FrameRays> frames = list_rays_at(sequence, pose, options);
    std::size_t n = 0;
    for (const FrameRays& f : frames) n += f.rays.size();
    if (n == 0) return result;
    double step_m = 2.0 * kPlaceStep_m;
    for (int i = 0; i < kMostPlaceSteps && step_m > kPlaceStep_m; ++i) {
        RigidEquations equations;
        for (const FrameRays& f : frames) {
            const std::vector<VisibleSurface> seen = view(f.position, f.rays, track);
            equations += parallel_reduce(seen.size(), kPointsOfPart, [&](std::size_t begin, std::size_t end) {
                RigidEquations part;
                for (std::size_t k = begin; k < end; ++k) {
                    const ThinPoint& point = f.points[k];
                    if (seen[k].normal == glm::dvec3(0.0)) continue;
                    part.add(make_plane_residual_row(place_point_in_world(track, point),
                                                     {seen[k].point_m, seen[k].normal}, kScale_m),
                             get_pose_share(point, pose));
                }
                return part;
            });
        }
        result.on_surfaces = double(equations.count_points_on_planes()) / double(n);
        if (equations.empty()) return result;
        const Twist step = equations.solve(kPlacePrior, compute_twist(before, track.pose[pose]));
        track.pose[pose] = apply_twist(track.pose[pose], step);
        step_m = compute_length_m(step);
    }
    const double moved_m = glm::distance(before.translation, track.pose[pose].translation);
    if (!PlaneAdjustment::is_placed(result.on_surfaces, n) || moved_m > options.largest_m) return result;
    result.world_from_vehicle = track.pose[pose];
    result.moved_m = moved_m;
    result.found = true;
    return result;
}

}  // namespace relidar
