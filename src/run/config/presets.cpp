// SPDX-License-Identifier: Apache-2.0
// Named starting points. `paper` is what docs/method.md sections 2, 5 and 6 print; the
// others say where they differ and why.
#include <relidar/run/config.hpp>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

/// The paper: the defaults of the structs, and the unnormalised range D it scores.
Config paper() {
    Config config;
    config.dataset.waymo_intensity = "clamp";
    config.init.actor_classes = "vehicle";  // as it says; people and cyclists are left in the background
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

/// The settings that the paper's authors released, where docs/method.md section 5 says
/// that they differ from the text: their intensity loss has a share of SSIM, which wants
/// whole images; their Chamfer distance is computed without a gradient, so training is
/// without it; and surfels that leave their box cost something. What section 10 calls
/// faults of their program is in no setting.
Config released() {
    Config config = paper();
    config.preset = "released";
    config.loss.intensity_ssim = 0.15f;
    config.loss.chamfer = 0.0f;
    config.loss.box = 0.01f;
    return config;
}

/// What measured best on a real log (KITTI raw 0005; the numbers are in docs/results.md):
/// a dense start from smoothed points, so that training refines surfaces instead of
/// finding them, and no densification is needed.
Config standard() {
    Config config;
    config.preset = "default";
    // as far as the log's sensor sees; the published protocol cuts at 80 m
    config.dataset.max_range_m = 0.0;
    // beams of an HDL-64E differ more than surfaces: the same places differ by 0.092 on
    // KITTI's, 0.077 with it
    // ranges by up to 6 cm on KITTI's HDL-64E, more than all other errors
    config.sensor.calibrate = "range,intensity";
    config.init.voxel_m = 0.1;           // silhouettes: surfels overhang an edge by about their size
    config.init.voxel_growth = 0.006;    // about the distance of neighbouring rays
    config.init.normal_neighbours = 24;  // 6 points of 2 cm noise tilt a normal by some 0.1 rad
    // leaves and corners: Chamfer of points 0.107 -> 0.102 m, RMSE 2.19 -> 2.10 m
    config.init.flatness = 0.04;
    config.init.unlabelled_movers = UnlabelledMovers::actors;  // boxes cover the front camera's view only
    config.init.opacity = 0.8;
    // a surface starts at 12 % drops instead of 27 %: about what sensors have
    config.init.hit_margin = 2.0;
    config.init.scale_factor = 0.4;
    config.init.max_scale_m = 0.3;
    config.init.second_returns = true;
    // else another sensor sees the road between the rings of a log of 32 beams as holes
    config.init.max_gap_m = 2.0;
    // 3D Gaussians, street of `demo`, 150 steps: median range error 9.3 mm as with
    // surfels; 0.2: 10.7 mm, spheres: 44 mm
    config.init.thickness = 0.05;
    config.image.sh_direction = ShDirection::surfel;  // 48 coefficients a surfel and frame instead of a hit
    config.image.transmittance_min = 1e-3f;
    config.loss.intensity = 0.3f;  // its Huber loss finds means, L1 medians:
    // RMSE 0.0866 -> 0.0846 and, on 50:100, 0.0911 -> 0.0898 (`quick`, degree 1)
    config.loss.intensity_delta = 0.2f;
    config.loss.normalised_depth = true;  // with D a weight of 0.97 pushes every surface 3 % away
    // 0.01 changed no metric by more than 1 % over 110 steps of `quick`, and costs a
    // tenth of a step
    config.loss.chamfer = 0.0f;
    config.loss.opacity = 0.1f;      // what D no longer does: close the holes
    config.loss.likelihood = 0.05f;  // Chamfer of points 0.122 -> 0.111 m, median range error 21 -> 19 mm
    config.train.iterations = 3000;
    config.train.sh_degree_start = 1;  // intensities start with their fall with the angle of incidence
    config.train.sh_degree_interval = 500;
    config.train.mean_rate = 1e-5;  // points are right to 2 cm already
    config.train.mean_rate_final = 1e-6;
    config.train.rotation_rate = 3e-4;
    config.train.scale_rate = 1e-2;
    // without end a tenth grew beyond 0.5 m in 1900 steps of `quick`, some to 8 m
    config.train.max_growth = 8.0;
    config.train.sh_rate = 3e-2;
    // else intensities know the few views that they have seen too well
    config.train.intensity_factor = 0.25;
    config.train.rate_decay = 0.05;
    config.train.sensor_drop = true;
    // logs drift by decimetres, and a scene of drifting scans has double walls
    config.train.refine_poses = "sensor";
    config.refine.enabled = true;  // drop accuracy 0.963 -> 0.973 of a scene trained by `quick`
    config.refine.frames = 200;    // their images are held at once, and a long log has thousands
    config.render.range = "normalised";
    config.render.follow_sweeps = true;  // heads turn unevenly: RMSE of held-out scans 1.89 -> 1.76 m
    config.trace.chunk = 64;             // with the cut by transmittance one pass is nearly always enough
    return config;
}

/// Minutes on a CPU: small batches of rays, fewer steps.
Config quick() {
    Config config = standard();
    config.preset = "quick";
    config.init.voxel_growth = 0.01;
    // below 1 - alpha_max, else an opaque surfel would end the ray unseen
    config.image.transmittance_min = 9e-3f;
    // a step takes four fifths of its time, scores change by 1 % (docs/performance.md)
    config.image.alpha_min = 0.04f;
    config.image.sh_degree = 2;
    config.train.iterations = 540;
    // few steps, each of which meets few surfels: rates that get there (docs/results.md).
    // Discs that grow this fast need train.max_growth
    config.train.opacity_rate = 0.15;
    config.train.scale_rate = 6.5e-2;
    config.train.rotation_rate = 5e-3;
    config.train.sh_rate = 8e-2;
    config.train.intensity_factor = 0.5;
    config.train.rays_per_iteration = 24576;
    config.train.sh_degree_interval = 180;
    // saves up to a sixth of a step on a CPU, costs 2 % of RMSE and Chamfer
    // (docs/performance.md)
    config.train.only_touched = true;
    config.train.log_every = 20;
    config.refine.network = "pixel";  // nearly all of what "small" gains, for a quarter of its time
    config.refine.frames = 32;
    config.refine.epochs = 4;
    // ten times that of larger ones: as good as 12 epochs at 2e-3, or better
    // (docs/performance.md)
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
