// SPDX-License-Identifier: Apache-2.0
// Compiles every pipeline by constructing the objects of training and rendering.
#include "train/compile_pipelines.hpp"

#include <relidar/diff/forward.hpp>
#include <relidar/diff/network_training.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "gpu/radix_sort.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

/// Returns settings (key and value) that select other variants of kernels. Each is
/// compiled with the preset `default`. Add a row for each new specialisation constant.
std::vector<std::pair<std::string, std::string>> list_kernel_settings() {
    std::vector<std::pair<std::string, std::string>> settings{{"image.sh_direction", "ray"},
                                                              {"image.sh_direction", "surfel"},
                                                              {"image.single_drop_logit", "true"},
                                                              {"train.deterministic", "true"},
                                                              {"train.refine_poses", "sensor,actors"},
                                                              {"render.range", "mode"},
                                                              {"trace.chunk", "16"},
                                                              {"trace.chunk", "64"},
                                                              {"densify.strategy", "adaptive"}};
    // The weight of each loss, which enables its kernels.
#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) \
    settings.push_back({"loss." #setting, "0.1"});
    RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    for (const PrimitiveProperties& kind : kPrimitives) settings.push_back({"image.primitive", kind.name});
    return settings;
}

/// Returns a scene with a background and an actor, each with one surfel.
Scene minimal_scene(const Log& street, PrimitiveType primitive) {
    Scene scene;
    scene.surfels.resize(2, primitive);
    scene.models = {{"background", 0, 1}, {"actor", 1, 1}};
    scene.instances = {{0, {}}, {1, street.boxes.empty() ? std::string() : street.boxes.front().id}};
    return scene;
}

/// Compiles the kernels of training and of rendering with these settings.
void compile_training(Device& device, const Log& street, const Config& config) {
    const Scene scene = minimal_scene(street, config.image.primitive);
    Split split;
    split.train = {0, 1};
    const TrainLoop loop(device, street, split, scene, config);
    const ScanRenderer renderer(device, scene, config, street);
}

/// Compiles all variants of the ray traversal. A running program uses only one of them,
/// which depends on the type of the device.
void compile_traversal(Device& device, const Log& street) {
    const Config config = make_preset("default");
    const Scene scene = minimal_scene(street, config.image.primitive);
    for (const BvhTraversalMode traversal_mode : {BvhTraversalMode::lane, BvhTraversalMode::subgroup})
        for (const ProxyShape proxy : {ProxyShape::triangles, ProxyShape::boxes}) {
            RendererOptions options{.accel = {.proxy = proxy}, .trace = training_options(config)};
            options.trace.traversal_mode = traversal_mode;
            for (const HitSortMethod order : {HitSortMethod::chunks, HitSortMethod::lists}) {
                options.trace.order = order;
                // The constructors of the renderers compile the kernels.
                const Renderer renderer(device, scene, config.image, options);
            }
            for (const GradientReduction sums : {GradientReduction::atomics, GradientReduction::gather})
                const DifferentiableRenderer renderer(device, scene, config.image, options,
                                                      {.sums = {.reduction = sums}});
        }
}

}  // namespace

void compile_pipelines(Device& device, const std::function<void(const std::string&)>& report_progress) {
    const Log street = make_street_log({.n_frames = 2, .rows = 2, .columns = 16});
    const auto report = [&](const std::string& text) {
        if (report_progress) report_progress(text);
    };
    for (const char* preset : {"paper", "released", "default", "quick"}) {
        report(preset);
        compile_training(device, street, make_preset(preset));
    }
    for (const auto& [key, value] : list_kernel_settings()) {
        report(key + "=" + value);
        Config config = make_preset("default");
        set_value(config, key, value);
        compile_training(device, street, config);
    }
    report("kernels of the ray traversal and of sums of gradients");
    compile_traversal(device, street);
    for (const char* network : {"small", "paper", "pixel"}) {
        report(std::string("refine.network=") + network);
        RayDropNetworkOptions options;
        options.network = network;
        compile_network(device, options);
    }
    report("kernels that add gradients of hits in a fixed order");
    // The training loops above did not compile these, because BackwardPass sorts hits by
    // their rows only in its first batch.
    const RadixSort by_row(device, 1, 1);
}

}  // namespace relidar
