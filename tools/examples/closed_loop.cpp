// SPDX-License-Identifier: Apache-2.0
// Example: a simulator that runs a closed loop at 10 Hz. It moves the ego car and one
// actor of the run. The ego car starts at the first pose of the log. It brakes when its
// simulated LiDAR measures a short distance ahead. The actor drives 25 m ahead of the ego
// car and brakes after two seconds.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>

#include <relidar/relidar.hpp>

using namespace relidar;

constexpr double kStep_s = 0.1, kLane_m = 1.2, kActorBrakes_mps2 = 4.0, kEgoBrakes_mps2 = 6.0;

double free_distance_m(const LidarPoints& points) {
    double gap_m = 100.0;
    for (const glm::vec3& p : points.position_m) {
        if (p.x > 3.0f && std::abs(p.y) < kLane_m && p.z > -1.2f && p.z < 0.5f)
            gap_m = std::min(gap_m, double(p.x));
    }
    return gap_m;
}

int main(int argc, char** argv) try {
    if (argc != 2) {
        std::fprintf(stderr, "usage: %s RUN\n", argv[0]);
        return 2;
    }
    const Run run = load_run(argv[1]);
    if (run.scene.instances.size() < 2)
        throw UsageError("closed_loop: found a run without actors, expected at least one actor");
    const std::string actor = run.scene.instances[1].track;
    Device device;
    ScanRenderer renderer(device, run);
    const SimulatedSensor sensor = make_sensor(run.config, run.log);

    Pose start = run.log.lidar_track(0).pose.front();
    // converts the pose to the world frame of the dataset, which requests use
    start.translation += run.log.world_offset_m;
    const auto ahead = [&](double metres, double up_m) {
        return start * Pose{{1, 0, 0, 0}, {metres, 0, up_m}};
    };
    double ego_m = 0.0, ego_mps = 8.0, actor_m = 25.0, actor_mps = 8.0;
    for (int step = 0; step < 80; ++step) {
        const double t = step * kStep_s;
        const ScanRequest request{
            .time_s = t,
            .dataset_from_sensor = {{t, t + kStep_s}, {ahead(ego_m, 0), ahead(ego_m + ego_mps * kStep_s, 0)}},
            .dataset_from_actor = ActorTracksByName{
                {actor,
                 {{t, t + kStep_s}, {ahead(actor_m, -1.0), ahead(actor_m + actor_mps * kStep_s, -1.0)}}}}};
        renderer.submit_points(sensor, request, t);
        const double gap_m = free_distance_m(renderer.wait_for_points().points);
        if (gap_m < 6.0 + ego_mps * ego_mps / (2.0 * kEgoBrakes_mps2) * 1.3)
            ego_mps = std::max(0.0, ego_mps - kEgoBrakes_mps2 * kStep_s);
        if (t > 2.0) actor_mps = std::max(0.0, actor_mps - kActorBrakes_mps2 * kStep_s);
        if (step % 10 == 0)
            std::printf("%4.1f s  ego %4.1f m/s  actor %4.1f m/s  nearest ahead %5.1f m\n", t, ego_mps,
                        actor_mps, gap_m);
        ego_m += ego_mps * kStep_s;
        actor_m += actor_mps * kStep_s;
    }
    std::printf("stopped %.1f m behind the actor\n", actor_m - ego_m);
    return ego_mps == 0.0 && actor_m - ego_m > 3.0 ? 0 : 1;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
