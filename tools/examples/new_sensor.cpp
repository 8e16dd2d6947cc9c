// SPDX-License-Identifier: Apache-2.0
// Example: renders scans of another sensor on another path. It simulates an Ouster OS1-64
// on a trajectory and removes the first actor of the log.
#include <cstdio>
#include <exception>

#include <relidar/relidar.hpp>

using namespace relidar;

int main(int argc, char** argv) try {
    if (argc != 4) {
        std::fprintf(stderr, "usage: %s RUN TRAJECTORY.csv OUT\n", argv[0]);
        return 2;
    }
    Run run = load_run(argv[1]);
    // Instance 0 is the background, so instance 1 is the first actor.
    if (run.scene.instances.size() > 1)
        run.set_driving_scene(remove_track(run.driving_scene(), run.scene.instances[1].track));
    const PoseTrack trajectory = read_trajectory(argv[2]);
    const SimulatedSensor sensor = choose_sensor("OS1-64", run.config, run.sequence);

    Device device;
    ScanRenderer renderer(device, run);
    ScanOutputOptions format = default_options(run, sensor);
    format.formats = {"pcd", "png"};
    format.trajectory = argv[2];
    ScanFolderWriter scans(argv[3], format);
    int n = 0;
    for (double t = trajectory.time_s.front(); t <= trajectory.time_s.back(); t += 0.1)
        scans.write_scan(n++, renderer.render(sensor, {t, trajectory}));
    scans.finish();
    std::printf("%d scans of %zu rays in %s\n", n, sensor.rays.size(), argv[3]);
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
