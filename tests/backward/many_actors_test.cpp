// SPDX-License-Identifier: Apache-2.0
// A thousand copies of an actor in one scene: one model placed a thousand times, and a thousand models. Image and gradients against the double
// reference, twenty steps of training, and as many launches as for two copies.
#include <numeric>
#include <random>

#include <relidar/stages/optimizer.hpp>

#include "passes.hpp"

namespace relidar {
namespace {

using test::Passes;

constexpr int kAcross = 10;   // actors along each axis of a lattice of 3 m

/// Copies of an actor, each with a turn of its own, in front of a sensor at the origin. @param own every copy has surfels of its own, all different
test::RandomScene many_actors(bool own, int n_actors) {
    constexpr int kSurfels = 12;
    const test::RandomScene drawn = test::make_random_scene({.seed = 71, .background_surfels = own ? kSurfels * n_actors : kSurfels, .actor_surfels = 0, .actor_instances = 0, .rays = 0}, {});
    std::mt19937_64 random(72);
    std::uniform_real_distribution<double> turn(-0.5, 0.5);
    test::RandomScene scene;
    scene.view_origin = glm::dvec3(glm::vec3(0.1f, -0.2f, 0.2f));
    scene.world.surfels = drawn.world.surfels;
    for (reference::Surfel& s : scene.world.surfels) s.mean.x = double(float(0.25 * (s.mean.x - 6.0)));   // of a corridor of 2 to 10 m
    for (int i = 0; i < n_actors; ++i) {
        const glm::dvec3 place(6 + 3 * (i % kAcross), 3.0 * (i / kAcross % kAcross) - 13.5, 3.0 * (i / (kAcross * kAcross)) - 13.5);
        const glm::dvec3 axis = glm::normalize(glm::dvec3(turn(random), turn(random), 1.0));
        scene.world.instances.push_back({static_cast<std::uint32_t>(own ? kSurfels * i : 0), kSurfels, {glm::angleAxis(turn(random), axis), place}});
    }
    return scene;
}

/// Rays towards actors, those that keep the margins of a comparison or any.
void add_rays(test::RandomScene& scene, std::size_t n, const reference::Settings* margins) {
    std::mt19937_64 random(73);
    std::uniform_real_distribution<double> aside(-0.4, 0.4);
    for (int attempt = 0; attempt < 2000 && scene.rays.size() < n; ++attempt) {
        const glm::dvec3 towards = scene.world.instances[random() % scene.world.instances.size()].world_from_model.translation + glm::dvec3(aside(random), aside(random), aside(random));
        const reference::Ray ray{glm::dvec3(0.0), glm::dvec3(glm::vec3(glm::normalize(towards)))};
        if (!margins || test::keeps_margins(scene.world, *margins, ray, {})) scene.rays.push_back(ray);
    }
}

std::vector<float> column(const std::vector<float>& rendered, std::size_t k) {
    std::vector<float> values;
    for (std::size_t i = k; i < rendered.size(); i += kRenderedFloats) values.push_back(rendered[i]);
    return values;
}

class ManyActors : public test::DeviceTest {
protected:
    /// One model a thousand times with SH along the ray, or a thousand models with SH a surfel.
    static ImageModel image_of(bool own) { return {.sh_direction = own ? ShDirection::surfel : ShDirection::ray}; }
};

TEST_F(ManyActors, ImageAndGradientsAgreeWithTheReference) {
    for (const bool own : {false, true}) {
        reference::Settings settings;
        settings.image = image_of(own);
        test::RandomScene scene = many_actors(own, kAcross * kAcross * kAcross);
        settings.view_origin = scene.view_origin;
        add_rays(scene, 30, &settings);
        ASSERT_EQ(scene.rays.size(), 30u);
        const std::vector<reference::PixelGradient> upstream = test::random_upstream(scene.rays.size(), 74);
        const reference::BruteForce brute(scene.world, settings.image, reference::Precision::double_record);
        reference::Gradients expected(scene.world);
        test::GradientTable table;
        Passes passes(device(), settings.image, scene, upstream, Proxy::boxes, {});
        passes.run();
        const std::vector<float> rendered = passes.rendered.download();
        for (std::size_t i = 0; i < scene.rays.size(); ++i) {
            const reference::Pixel pixel = reference::render(scene.world, brute, settings, scene.rays[i], 16);
            reference::backward(scene.world, brute, settings, scene.rays[i], 16, upstream[i], expected);
            const float* r = rendered.data() + i * kRenderedFloats;
            table.add_row("pixel", {pixel.depth, pixel.weight, pixel.intensity, pixel.hit_logit, pixel.drop_logit}, test::lanes(r, kUpstreamFloats));
            EXPECT_GT(pixel.hits, 0u);
        }
        test::add_surfel_rows(table, expected.surfels, passes.gradients.surfels.download());
        table.print(own ? "1000 models" : "1000 instances of a model");
        for (const auto& [name, group] : table.groups()) {
            EXPECT_LE(group.worst_error(), test::kKernelGradient) << name;
            EXPECT_EQ(group.missing_rows(), 0u) << name;
            EXPECT_GT(group.nonzero_rows(), 0u) << name;
        }
    }
}

/// Measured: 0.1 m behind and 0.1 brighter than what is rendered at first.
std::vector<DeviceTarget> targets_beside(const std::vector<float>& rendered) {
    const std::vector<float> depth = column(rendered, 0), intensity = column(rendered, 2);
    std::vector<DeviceTarget> targets(depth.size());
    for (std::size_t i = 0; i < targets.size(); ++i) targets[i] = {depth[i] + 0.1f, intensity[i] + 0.1f};
    return targets;
}

/// Losses of twenty steps of a scene that moves a little before each.
std::vector<float> train(Passes& passes) {
    passes.run_forward();
    passes.stream.finish();
    const std::vector<DeviceTarget> values = targets_beside(passes.rendered.download());
    const Array<DeviceTarget> targets(passes.device, std::span<const DeviceTarget>(values), "targets");
    const Array<float> terms(passes.device, kLossTerms, "loss terms");
    const auto n = static_cast<std::uint32_t>(values.size());
    ImageLoss loss(passes.device, {});
    Adam adam(passes.device, passes.scene.size(), {});
    std::vector<InstancePose> placed = passes.scene.poses();
    std::vector<float> losses;
    for (int step = 1; step <= 20; ++step) {
        for (InstancePose& pose : placed) pose.world_from_model.translation.y += 1e-4;
        passes.scene.place(passes.stream, placed);
        passes.stream.fill(terms);
        passes.run_forward();
        loss.run(passes.stream, {&targets, 0, 1, n, double(n), double(n)}, passes.rendered, passes.upstream, terms);
        passes.backward.run(passes.stream, passes.scene, passes.accel, {passes.batch(), &passes.rendered, &passes.upstream}, passes.view_origin, passes.gradients);
        adam.step(passes.stream, passes.scene.parameters(), passes.gradients.surfels, &passes.gradients.touched, {1e-3, 1e-3, 5e-3, 0.05, 0.01, 0.05}, step, 3);
        passes.stream.finish();
        const std::vector<float> all = terms.download();
        losses.push_back(std::accumulate(all.begin(), all.end(), 0.0f));
    }
    return losses;
}

TEST_F(ManyActors, Train) {
    for (const bool own : {false, true}) {
        test::RandomScene scene = many_actors(own, kAcross * kAcross * kAcross);
        add_rays(scene, 1000, nullptr);
        Passes passes(device(), image_of(own), scene, std::vector<reference::PixelGradient>(scene.rays.size()), Proxy::boxes, {});
        const std::vector<float> losses = train(passes);
        std::printf("%s: loss %.5f, after 20 steps %.5f\n", own ? "1000 models" : "1000 instances of a model", double(losses.front()), double(losses.back()));
        EXPECT_LT(losses.back(), 0.8f * losses.front());
        for (const float l : losses) EXPECT_TRUE(std::isfinite(l));
        const Surfels end = passes.scene.parameters().download();
        for (const ParameterGroup& group : groups_of(end.primitive()))
            for (const float x : group.values(end)) ASSERT_TRUE(std::isfinite(x)) << group.name;
    }
}

/// What an iteration launches does not depend on how many models there are, but for the levels of the collapse of the tree.
TEST_F(ManyActors, AreLaunchedTogether) {
    if (!device().info().timestamps) GTEST_SKIP() << "no timestamps: launches are not counted";
    SurfelLoss surfel_loss(device(), {.box = 0.1f, .opacity_entropy = 0.1f});
    const Array<float> terms(device(), kLossTerms, "loss terms");
    const auto launches = [&](int n_actors) {
        test::RandomScene scene = many_actors(true, n_actors);
        add_rays(scene, 10, nullptr);
        Passes passes(device(), image_of(true), scene, std::vector<reference::PixelGradient>(scene.rays.size()), Proxy::boxes, {});
        passes.run();   // builds the tree
        Stream stream(device(), true);
        passes.scene.activate(stream, passes.model, passes.view_origin);
        passes.accel.update(stream, passes.scene);
        passes.forward.run(stream, passes.scene, passes.accel, passes.batch(), passes.rendered);
        passes.backward.run(stream, passes.scene, passes.accel, {passes.batch(), &passes.rendered, &passes.upstream}, passes.view_origin, passes.gradients);
        surfel_loss.run(stream, passes.scene, {&passes.gradients.surfels, nullptr}, terms);
        stream.finish();
        std::map<std::string, std::size_t> counts;
        for (const auto& [kernel, times] : stream.times().milliseconds) counts[kernel] = times.size();
        return counts;
    };
    EXPECT_EQ(launches(1000), launches(2));
}

}  // namespace
}  // namespace relidar
