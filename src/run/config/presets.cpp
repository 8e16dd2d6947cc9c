// SPDX-License-Identifier: Apache-2.0
// The preset `paper` has the values of docs/method.md sections 2, 5 and 6.
#include <relidar/run/config.hpp>

#include "base/fail.hpp"

namespace relidar {
namespace {

/// Returns the settings of the LiDAR-RT paper, which are mostly the defaults of the
/// structs.
Config paper_preset() {
    Config config;
    config.dataset.waymo_intensity = "clamp";
    // as in the paper: only vehicles become actors; people and cyclists are background
    config.init.actor_classes = "vehicle";
    config.init.mask_others = false;
    config.init.actor_min_points = 100;
    config.init.deform = "";
    config.init.actor_pad_to = 8000;
    config.render.range = "expected";  // not divided by the sum of the blending weights
    config.densify.strategy = DensifyStrategy::adaptive;
    config.refine = {.enabled = true,
                     .network = "paper",
                     .image = "grid",
                     .rays = "origin,direction",
                     .frames = 0,
                     .epochs = 500,
                     .rate = 1e-3};
    return config;
}

/// Returns the settings of the program that the authors of the paper released. It differs
/// from the text of the paper (docs/method.md section 5). Its errors (section 10) are not
/// reproduced.
Config released_preset() {
    Config config = paper_preset();
    config.preset = "released";
    // The structural similarity (SSIM) needs full images.
    config.loss.intensity_ssim = 0.15f;
    config.loss.chamfer = 0.0f;
    config.loss.box = 0.01f;
    return config;
}

/// Returns the settings with the best results on a real log (KITTI raw 0005,
/// docs/results.md). Training adds no surfels, because it starts from dense, smoothed
/// points.
Config default_preset() {
    Config config;
    config.preset = "default";
    // 0: uses the maximum range of the sensor, instead of the 80 m of published results
    config.dataset.max_range_m = 0.0;
    // The beams of a LiDAR have different range offsets and intensity gains.
    config.sensor.calibrate = "range,intensity";
    // Small voxels give small surfels. Large surfels would blur the edges of objects.
    config.init.voxel_m = 0.1;
    config.init.voxel_growth = 0.006;    // approximately the spacing of neighbouring rays
    config.init.normal_neighbours = 24;  // with 6 points, noise of 2 cm would tilt a normal by 0.1 rad
    // Maximum ratio (variance across a surface) / (variance within it) of neighbouring
    // points. Other points, for example on leaves, become surfels that face the sensor.
    config.init.flatness = 0.04;
    // KITTI labels only objects that its front camera sees.
    config.init.unlabelled_movers = UnlabelledMoverPolicy::actors;
    config.init.opacity = 0.8;
    // Initial ray-drop probability: 1 / (1 + exp(hit_margin)) = 12 %, which is typical.
    config.init.hit_margin = 2.0;
    config.init.scale_factor = 0.4;
    config.init.max_scale_m = 0.3;
    config.init.second_returns = true;
    // A smaller value would leave holes between the rings of a 32-beam LiDAR.
    config.init.max_gap_m = 2.0;
    // With this thickness, 3D Gaussians have the same range error as flat surfels.
    config.init.thickness = 0.05;
    config.image.sh_direction = ShDirection::surfel;
    config.image.transmittance_min = 1e-3f;
    config.loss.intensity = 0.3f;
    config.loss.intensity_delta = 0.2f;  // Huber loss; its RMSE is lower than with L1
    // Divides ranges by the sum of weights. A sum of 0.97 would shift surfaces by 3 %.
    config.loss.normalised_depth = true;
    config.loss.chamfer = 0.0f;      // off, because it changes metrics by less than 1 % and takes time
    config.loss.opacity = 0.1f;      // closes holes that remain with the normalised range
    config.loss.likelihood = 0.05f;  // this loss lowers the Chamfer distance and the median range error
    config.train.iterations = 3000;
    config.train.sh_degree_start = 1;  // models the effect of incidence on intensity from the start
    config.train.sh_degree_interval = 500;
    config.train.mean_rate = 1e-5;  // the initial points are already accurate to 2 cm
    config.train.mean_rate_final = 1e-6;
    config.train.rotation_rate = 3e-4;
    config.train.scale_rate = 1e-2;
    config.train.max_growth = 8.0;  // without this limit, some surfels grow far too large, up to 8 m
    config.train.sh_rate = 3e-2;
    // Learning rate of intensities relative to drop probabilities. A factor of 1 would
    // overfit, because few rays observe each surfel.
    config.train.intensity_factor = 0.25;
    config.train.rate_decay = 0.05;
    config.train.sensor_drop = true;
    config.train.refine_poses = "sensor";  // poses drift by decimetres, which causes double walls
    config.refine.enabled = true;          // the network improves the accuracy of ray-drop
    config.refine.frames = 200;  // limited because the images of all these frames are in memory together
    config.render.range = "normalised";
    // LiDAR heads rotate at varying speed, so the measured azimuths of a sweep are used.
    config.render.follow_sweeps = true;
    // With 64 hits per chunk, nearly every ray becomes opaque within its first chunk.
    config.trace.chunk = 64;
    return config;
}

/// Returns settings for training on a CPU in minutes: fewer rays and fewer steps.
Config quick_preset() {
    Config config = default_preset();
    config.preset = "quick";
    config.init.voxel_growth = 0.01;
    // A ray ends before the surfel that would reduce its transmittance below this value.
    // An opaque surfel leaves 0.01, so the value must be smaller.
    config.image.transmittance_min = 9e-3f;
    // Larger than in `default`, so that more of the faint edge of each surfel is skipped.
    // Rays then hit fewer surfels, and training is faster.
    config.image.alpha_min = 0.04f;
    config.image.sh_degree = 2;
    config.train.iterations = 540;
    // Higher than in `default`, because there are few steps and each trains few surfels.
    config.train.opacity_rate = 0.15;
    config.train.scale_rate = 6.5e-2;
    config.train.rotation_rate = 5e-3;
    config.train.sh_rate = 8e-2;
    config.train.intensity_factor = 0.5;
    config.train.rays_per_iteration = 24576;
    config.train.sh_degree_interval = 180;
    // Updates only surfels with a gradient, which is faster but slightly less accurate.
    config.train.only_touched = true;
    config.train.log_every = 20;
    config.refine.network = "pixel";  // nearly as accurate as "small", in a quarter of its time
    config.refine.frames = 32;
    config.refine.epochs = 8;
    // Ten times the rate of the U-Nets: the small network `pixel` then needs few epochs.
    config.refine.rate = 2e-2;
    return config;
}

struct Preset {
    const char* name;
    Config (*make)();
};
constexpr Preset kPresets[] = {{"paper", paper_preset},
                               {"released", released_preset},
                               {"default", default_preset},
                               {"quick", quick_preset}};

}  // namespace

Config make_preset(const std::string& preset_name) {
    std::vector<std::string> preset_names;
    for (const Preset& preset : kPresets) {
        if (preset_name == preset.name) return preset.make();
        preset_names.emplace_back(preset.name);
    }
    fail<UsageError>("preset '{}': unknown{} (known: {})", preset_name,
                     did_you_mean(preset_name, preset_names, "'"), fmt::join(preset_names, ", "));
}

}  // namespace relidar
