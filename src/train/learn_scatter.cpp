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

}  // namespace

std::vector<IntensityScatterModel> learn_scatter(Device& device, const Run& run,
                                                 const ScanCallbacks& session) {
    Config config = run.config;
    config.sensor.sub_rays = config.sensor.returns = 1;
    ScanRenderer renderer(device, run.scene, config, run.sequence);
    const IgnoredMeasurements masks = mask_movers(config, run.scene);
    std::vector<IntensityScatterModel> result;
    for (int lidar = 0; lidar < int(run.sequence.lidars.size()); ++lidar) {
        std::vector<int> lidar_positions;
        for (const int position : run.split.train)
            if (run.sequence.frames[std::size_t(position)].lidar == lidar)
                lidar_positions.push_back(position);
        const std::vector<int> positions = select_evenly(lidar_positions, kMostFrames);
        std::vector<PairedIntensities> images;
        for (const int position : positions) {
            if (session.stop && session.stop()) return {};
            if (session.progress)
                session.progress("learning the scatter of intensities",
                                 double(images.size()) / double(positions.size()));
            const Frame& frame = run.sequence.frames[std::size_t(position)];
            const RenderedScan scan =
                renderer.render(nominal_sensor(config, run.sequence, frame), frame.time_s);
            std::vector<float> measured;
            // 0: returned. Drops and rays that may have hit moving objects are ignored.
            const std::vector<float> dropped = classify_drops(run.sequence, frame, masks);
            for (std::size_t i = 0; i < dropped.size(); ++i)
                measured.push_back(dropped[i] == 0.0f ? frame.scan.intensity[i] : kNoIntensity);
            images.push_back({make_noise_image(scan), std::move(measured)});
        }
        result.push_back(fit_scatter(images));
        if (session.progress) session.progress("learning the scatter of intensities", 1.0);
    }
    return result;
}

}  // namespace relidar
