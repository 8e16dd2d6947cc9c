// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <filesystem>

#include <relidar/log/camera.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

inline Pose make_example_pose(double fraction) {
    return {glm::normalize(glm::dquat(1.0, 0.1 / 3.0 * fraction, -0.7 / 9.0, 0.2 * fraction)),
            {1.0 / 3.0 * fraction, -2e-7 / 3.0, 4.1e3 + fraction / 7.0}};
}

inline Surfels make_example_surfels(std::size_t count) {
    Surfels surfels;
    surfels.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
        const float x = static_cast<float>(i) + 1.0f / 3.0f;
        surfels.mean[i] = {x, -x / 7.0f, 1e-20f * x};
        surfels.rotation[i] = {1.0f, x, 2.0f * x, -x};
        surfels.log_scale[i] = {-x, -2.0f * x};
        surfels.opacity_logit[i] = -2.2f + x;
        for (std::size_t k = 0; k < kShFloats; ++k)
            surfels.sh[i * kShFloats + k] = std::sin(x * static_cast<float>(k));
    }
    return surfels;
}

inline RayDropNetwork make_example_network() {
    RayDropNetwork network;
    network.image = "kitti360";
    network.inputs = {"log_range", "intensity", "drop_logit"};
    network.widths = {4, 8};
    network.heads = 2;
    network.residual = false;
    network.normalisation = {1.0f / 3.0f, -2.0f, 1e-20f, 0.0f, 5.0f, 6.0f};
    for (int i = 0; i < 1000; ++i) network.parameters.push_back(std::sin(float(i)) / 3.0f);
    network.running = {0.1f, 0.2f};
    network.actor_logits = {0.5f, -1.0f / 3.0f};
    return network;
}

inline Run make_example_run(const std::filesystem::path& folder) {
    Run run;
    run.folder = folder;
    run.config = make_preset("quick");
    // must not be 0, because loading replaces 0 by the limit of the log
    run.config.dataset.max_range_m = 80.0;
    run.config.dataset.path = "/data/log \"one\"";
    Log& s = run.log;
    s.name = "example \xC3\xA9";
    s.source = "somewhere";
    s.conventions = "none";
    s.start_unix_ns = 1317042145594360375;
    s.labelled_azimuth = {-2.0 / 3.0, 0.7};
    s.world_offset_m = {1e6 / 3.0, -5e6 / 7.0, 0.1};
    s.georeference = {{49.1 / 3.0, -8.4 / 7.0, 116.4},
                      {1.0 / 3.0, 2e5 / 7.0, 3.0},
                      "EPSG:32632",
                      make_example_pose(1.0).rotation};
    s.rolling_shutter = false;
    s.cameras = {kitti_camera()};
    s.lidars[0].sensor = {
        "sensor",
        {{0.1, 0.0, 0.0, 0.2, 0.01, 1.1, -0.03, 0.02}, {-0.1 / 3.0, 1e-3, 0.0, 0.12, 0.0, 0.9, 0.03, -0.02}},
        1030,
        0.1,
        true,
        3.14,
        {},
        0.5,
        80.0,
        1e-3};
    for (int i = 0; i < 4; ++i) {
        s.frames.push_back({10 + i, 1.3e9 + i / 10.0, {}});
        s.world_from_vehicle.append(s.frames.back().time_s, make_example_pose(i));
    }
    for (int k = 0; k < s.lidars[0].sensor.columns; ++k)
        s.frames[1].azimuth_shift_rad.push_back(1e-3f / 3.0f * float(k) - 2e-3f);
    s.boxes.push_back({"7",
                       "Car",
                       {4.2, 1.8, 1.5},
                       {{1.3e9, 1.3e9 + 0.1}, {make_example_pose(0.5), make_example_pose(0.6)}}});
    s.boxes.push_back({"8", "Van", {5.2, 2.0, 2.5}, {}});
    run.split = {{0, 1}, {2}};  // frame 3 is unused
    run.scene = wrap_background(make_example_surfels(5));
    run.edits = {{"/runs/first", "--move 7:0,3.5,0"}, {"/runs/second", "--remove 9"}};
    return run;
}

}  // namespace relidar
