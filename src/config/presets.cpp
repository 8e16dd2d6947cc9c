// SPDX-License-Identifier: Apache-2.0
// Named starting points. `paper` is what docs/method.md sections 2, 5 and 6 print; the others say where they differ and why.
#include <relidar/config.hpp>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {
namespace {

/// The paper: the defaults of the structs, and the unnormalised range D it scores.
Config paper() {
    Config config;
    config.preset = "paper";
    config.init.max_scale_m = 1000.0;   // the paper does not clamp
    config.render.range = "expected";
    return config;
}

/// Better than the paper in the same scene, and ready within minutes on a GPU.
Config standard() {
    Config config;
    config.preset = "default";
    config.image.sh_direction = ShDirection::surfel;   // 48 coefficients a surfel and frame instead of a hit
    config.loss.normalised_depth = true;               // D mixes range with opacity: an edge pixel would be pulled to the sensor
    config.train.iterations = 10000;
    config.train.rate_decay = 0.1;
    config.render.range = "median";                    // no points between two surfaces
    return config;
}

/// A first look in minutes on a CPU: coarser scene, small batches, all degrees of the harmonics early.
Config quick() {
    Config config = standard();
    config.preset = "quick";
    config.init.voxel_growth = 0.01;
    config.train.iterations = 600;
    config.train.rays_per_iteration = 4096;
    config.train.sh_degree_interval = 100;
    config.train.only_touched = true;   // a batch sees few surfels: the moments of the others would decay for nothing
    config.train.log_every = 20;
    return config;
}

struct Preset {
    const char* name;
    Config (*make)();
};
constexpr Preset kPresets[] = {{"paper", paper}, {"default", standard}, {"quick", quick}};

}  // namespace

Config make_preset(const std::string& name) {
    std::vector<std::string> known;
    for (const Preset& preset : kPresets) {
        if (name == preset.name) return preset.make();
        known.emplace_back(preset.name);
    }
    throw UsageError(fmt::format("preset '{}': unknown, did you mean '{}'? (known: {})", name, nearest_name(name, known), fmt::join(known, ", ")));
}

}  // namespace relidar
