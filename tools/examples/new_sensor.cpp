// SPDX-License-Identifier: Apache-2.0
// Example: renders scans of another sensor, on another path, in edited traffic.
#include <cstdio>
#include <exception>

#include <relidar/relidar.hpp>

using namespace relidar;

/// Renders scans of an Ouster OS1-64 that follows TRAJECTORY.csv. As an example of an
/// edit, removes the first actor of RUN. Writes the scans to the folder OUT.
int main(int argc, char** argv) try {
    constexpr double kScanPeriod_s = 0.1;
    if (argc != 4) {
        std::fprintf(stderr, "usage: %s RUN TRAJECTORY.csv OUT\n", argv[0]);
        return 2;
    }
    Run run = load_run(argv[1]);
    if (run.scene.instances.size() > 1)  // Instance 0 is the background.
        run.set_driving_scene(remove_track(run.driving_scene(), run.scene.instances[1].track));
    const PoseTrack trajectory = read_trajectory(argv[2]);
    const SimulatedSensor sensor = choose_sensor("OS1-64", run.config, run.log);

    Device device;
    ScanRenderer renderer(device, run);
    ScanOutputOptions format = default_options(run, sensor);
    format.formats = {"pcd", "png"};
    format.trajectory = argv[2];
    ScanFolderWriter scans(argv[3], format);
    int n_scans = 0;
    for (double t = trajectory.time_s.front(); t <= trajectory.time_s.back(); t += kScanPeriod_s)
        scans.write_scan(n_scans++, renderer.render(sensor, {t, trajectory}));
    scans.finish();
    std::printf("%d scans of %zu rays in %s\n", n_scans, sensor.rays.size(), argv[3]);
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
