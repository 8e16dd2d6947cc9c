// SPDX-License-Identifier: Apache-2.0
// Fits the random scatter of measured intensities for each LiDAR of a log. The residuals
// of training frames are about as large as those of held-out frames.
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {
namespace {

constexpr int kMostFrames = 16;  // maximum number of frames per LiDAR

/// Returns the training frames of a LiDAR, or some of them if there are many.
std::vector<int> select_lidar_frames(const Run& run, int lidar) {
    std::vector<int> positions;
    for (const int position : run.split.train)
        if (run.log.frames[std::size_t(position)].lidar == lidar) positions.push_back(position);
    return select_evenly(positions, kMostFrames);
}

/// Returns the measured intensities of a frame. Rays without a return, and rays that may
/// have hit a moving object, have none.
std::vector<float> known_intensities(const Log& log, const Frame& frame, const IgnoredMeasurements& masks) {
    std::vector<float> intensities;
    const std::vector<float> dropped = classify_drops(log, frame, masks);
    for (std::size_t ray = 0; ray < dropped.size(); ++ray)
        intensities.push_back(dropped[ray] == 0.0f ? frame.scan.intensity[ray] : kNoIntensity);
    return intensities;
}

}  // namespace

std::vector<IntensityScatterModel> learn_scatter(Device& device, const Run& run,
                                                 const ScanCallbacks& session) {
    Config config = run.config;
    config.sensor.sub_rays = config.sensor.returns = 1;
    ScanRenderer renderer(device, run.scene, config, run.log);
    const IgnoredMeasurements masks = mask_movers(config, run.scene);
    std::vector<IntensityScatterModel> result;
    for (int lidar = 0; lidar < int(run.log.lidars.size()); ++lidar) {
        const std::vector<int> positions = select_lidar_frames(run, lidar);
        std::vector<PairedIntensities> images;
        for (const int position : positions) {
            if (session.stop && session.stop()) return {};
            if (session.progress)
                session.progress("learning the scatter of intensities",
                                 double(images.size()) / double(positions.size()));
            const Frame& frame = run.log.frames[std::size_t(position)];
            const RenderedScan scan = renderer.render(nominal_sensor(config, run.log, frame), frame.time_s);
            images.push_back({make_noise_image(scan), known_intensities(run.log, frame, masks)});
        }
        result.push_back(fit_scatter(images));
        if (session.progress) session.progress("learning the scatter of intensities", 1.0);
    }
    return result;
}

}  // namespace relidar
