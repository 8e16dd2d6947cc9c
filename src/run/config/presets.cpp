// SPDX-License-Identifier: Apache-2.0
// Presets: named sets of default values for all settings. The preset `paper` has the
// values of docs/method.md sections 2, 5 and 6. Comments explain in which settings the
// other presets differ, and why.
#include <relidar/run/config.hpp>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

/// Returns the settings of the paper. They are the defaults of the structs, and the
/// unnormalised range D for rendering, because the paper evaluates D.
Config paper() {
    Config config;
    config.dataset.waymo_intensity = "clamp";
    // As in the paper, only vehicles become actors. People and cyclists belong to the
    // background.
    config.init.actor_classes = "vehicle";
    config.init.mask_others = false;
    config.init.actor_min_points = 100;
    config.init.deform = "";
    config.init.actor_pad_to = 8000;
    config.render.range = "expected";
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

/// Returns the settings of the program that the authors of the paper released
/// (docs/method.md section 5). They differ from the text of the paper. The intensity loss
/// includes SSIM, which needs full images. The Chamfer distance is computed without a
/// gradient, so it is not used for training. Surfels outside their box are penalised. The
/// errors of the released program (section 10) are not reproduced.
Config released() {
    Config config = paper();
    config.preset = "released";
    config.loss.intensity_ssim = 0.15f;
    config.loss.chamfer = 0.0f;
    config.loss.box = 0.01f;
    return config;
}

/// Returns the settings with the best results on a real log (KITTI raw 0005,
/// docs/results.md). The scene starts with a dense set of smoothed points. Training then
/// refines existing surfaces and needs no densification.
Config standard() {
    Config config;
    config.preset = "default";
    // 0 selects the maximum range of the sensor. Published results use 80 m.
    config.dataset.max_range_m = 0.0;
    // Calibrates the beams. The range offsets between the beams of an HDL-64E are
    // centimetres, more than all other errors. Two beams measure more different
    // intensities for one surface than one beam measures for different surfaces.
    config.sensor.calibrate = "range,intensity";
    // Small surfels give sharp silhouettes, because surfels extend beyond an edge by
    // about their size.
    config.init.voxel_m = 0.1;
    // Growth of the voxel edge, as a share of the distance to the sensor. It is
    // approximately the spacing of neighbouring rays.
    config.init.voxel_growth = 0.006;
    // With only 6 neighbours, range noise of 2 cm tilts a normal by 0.1 rad.
    config.init.normal_neighbours = 24;
    // With this threshold, discs that are not on a flat surface (leaves, corners) face
    // the sensor. This lowers the Chamfer distance and the range error.
    config.init.flatness = 0.04;
    // Moving objects without a label become actors. They are common, because KITTI has
    // labels only in the view of the front camera.
    config.init.unlabelled_movers = UnlabelledMovers::actors;
    config.init.opacity = 0.8;
    // Surfaces start with a drop probability of 12 %, which is typical for real sensors.
    config.init.hit_margin = 2.0;
    config.init.scale_factor = 0.4;
    config.init.max_scale_m = 0.3;
    config.init.second_returns = true;
    // Fills gaps up to this length. Otherwise other sensors would see holes between the
    // rings of a log with 32 beams.
    config.init.max_gap_m = 2.0;
    // Thickness of 3D Gaussians. With this thickness, they reach the range error of
    // surfels. Thicker Gaussians and spheres are less accurate.
    config.init.thickness = 0.05;
    // Evaluates spherical harmonics once for each surfel and frame, instead of once for
    // each hit.
    config.image.sh_direction = ShDirection::surfel;
    config.image.transmittance_min = 1e-3f;
    // The Huber loss fits the mean of the measured intensities. An L1 loss would fit the
    // median.
    config.loss.intensity = 0.3f;
    // This value lowers the root mean square error of held-out intensities.
    config.loss.intensity_delta = 0.2f;
    // Uses the normalised range. The range D is multiplied by the accumulated alpha, so
    // an alpha of 0.97 would move every surface by 3 %.
    config.loss.normalised_depth = true;
    // A Chamfer loss would change metrics by less than 1 % and make a training step 10 %
    // slower.
    config.loss.chamfer = 0.0f;
    // The opacity loss closes holes in surfaces. The loss of the normalised range does
    // not close them.
    config.loss.opacity = 0.1f;
    // The likelihood loss lowers the Chamfer distance and the median range error.
    config.loss.likelihood = 0.05f;
    config.train.iterations = 3000;
    // Starts with degree 1, so that the dependence of the intensity on the angle of
    // incidence is modelled from the start.
    config.train.sh_degree_start = 1;
    config.train.sh_degree_interval = 500;
    // A low learning rate is sufficient, because the initial points are already accurate
    // to 2 cm.
    config.train.mean_rate = 1e-5;
    config.train.mean_rate_final = 1e-6;
    config.train.rotation_rate = 3e-4;
    config.train.scale_rate = 1e-2;
    // Maximum growth of a surfel. Without this limit, many surfels grow far too large,
    // some to 8 m.
    config.train.max_growth = 8.0;
    config.train.sh_rate = 3e-2;
    // With a factor of 1, intensities overfit to the few views of a surfel.
    config.train.intensity_factor = 0.25;
    config.train.rate_decay = 0.05;
    config.train.sensor_drop = true;
    // Refines the sensor poses, because poses of a log drift by decimetres, which causes
    // double walls.
    config.train.refine_poses = "sensor";
    // Enables the ray-drop network, because it improves the accuracy of ray-drop.
    config.refine.enabled = true;
    // Limits the number of training images of the network, because all of them are in
    // memory at the same time.
    config.refine.frames = 200;
    config.render.range = "normalised";
    // Uses the measured azimuths of each sweep. Heads rotate unevenly, so this lowers the
    // range error.
    config.render.follow_sweeps = true;
    // Number of hits that are sorted at a time. Rays stop at low transmittance, so a
    // single pass is nearly always enough.
    config.trace.chunk = 64;
    return config;
}

/// Returns settings for training on a CPU in a few minutes, with small batches of rays
/// and few steps.
Config quick() {
    Config config = standard();
    config.preset = "quick";
    config.init.voxel_growth = 0.01;
    // The limit must be below 1 - alpha_max. Otherwise an opaque surfel would end a ray
    // before the surfel is blended.
    config.image.transmittance_min = 9e-3f;
    // Ignores more of the faint surfels. A training step is then about 20 % faster, and
    // metrics change by 1 % (docs/performance.md).
    config.image.alpha_min = 0.04f;
    config.image.sh_degree = 2;
    config.train.iterations = 540;
    // Learning rates are higher than in the default preset, because there are few steps
    // and each step reaches few surfels (docs/results.md). Discs that grow this fast need
    // the limit train.max_growth.
    config.train.opacity_rate = 0.15;
    config.train.scale_rate = 6.5e-2;
    config.train.rotation_rate = 5e-3;
    config.train.sh_rate = 8e-2;
    config.train.intensity_factor = 0.5;
    config.train.rays_per_iteration = 24576;
    config.train.sh_degree_interval = 180;
    // Updates only surfels that were hit. This saves up to a sixth of a step on a CPU. It
    // raises RMSE and Chamfer distance by about 2 % (docs/performance.md).
    config.train.only_touched = true;
    config.train.log_every = 20;
    // Smallest network. It is nearly as good as the network "small" and needs a quarter
    // of its time.
    config.refine.network = "pixel";
    config.refine.frames = 32;
    config.refine.epochs = 4;
    // Ten times the learning rate of larger networks. With few epochs, this rate is as
    // good as a lower rate with more epochs (docs/performance.md).
    config.refine.rate = 2e-2;
    return config;
}

struct Preset {
    const char* name;
    Config (*make)();
};
constexpr Preset kPresets[] = {
    {"paper", paper}, {"released", released}, {"default", standard}, {"quick", quick}};

}  // namespace

Config make_preset(const std::string& name) {
    std::vector<std::string> known;
    for (const Preset& preset : kPresets) {
        if (name == preset.name) return preset.make();
        known.emplace_back(preset.name);
    }
    throw UsageError(fmt::format("preset '{}': unknown{} (known: {})", name, did_you_mean(name, known, "'"),
                                 fmt::join(known, ", ")));
}

}  // namespace relidar
