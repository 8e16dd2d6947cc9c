// SPDX-License-Identifier: Apache-2.0
// Tests a scene with a thousand copies of an actor: a thousand instances of one model,
// and a thousand models.
#include <random>

#include <relidar/diff/loss.hpp>

#include "passes.hpp"

namespace relidar {
namespace {

using test::Passes;

constexpr int kAcross = 10;  // actors along each axis of a lattice
// distance between the actors, which is small so that single precision loses few digits
constexpr double kApart_m = 1.5;

/// Places copies of an actor in front of a sensor at the origin. Every third copy is
/// turned around. The poses have no rounding errors.
/// @param has_models true if every copy has separate, different surfels
test::RandomScene make_many_actors(bool has_models, int n_actors) {
    constexpr int kSurfels = 12;
    const int n_surfels = has_models ? kSurfels * n_actors : kSurfels;
    const test::RandomScene drawn = test::make_random_scene(
        {.seed = 71, .background_surfels = n_surfels, .actor_surfels = 0, .actor_instances = 0, .rays = 0},
        {});
    test::RandomScene scene;
    scene.view_origin = glm::dvec3(glm::vec3(0.1f, -0.2f, 0.2f));
    scene.world.surfels = drawn.world.surfels;
    // from a corridor of 2 to 10 m
    for (reference::Surfel& s : scene.world.surfels) s.mean.x = double(float(0.25 * (s.mean.x - 6.0)));
    for (int i = 0; i < n_actors; ++i) {
        const glm::dvec3 cell(i % kAcross, i / kAcross % kAcross - 4.5, i / (kAcross * kAcross) - 4.5);
        const glm::dquat rotation =
            i % 3 == 0 ? glm::dquat(0.0, 0.0, 0.0, 1.0) : glm::dquat(1.0, 0.0, 0.0, 0.0);
        const auto first = std::uint32_t(has_models ? kSurfels * i : 0);
        scene.world.instances.push_back(
            {first, kSurfels, {rotation, glm::dvec3(4.0, 0.0, 0.0) + kApart_m * cell}});
    }
    return scene;
}

/// Adds rays towards actors. Optionally, each ray must have a minimum distance to
/// discontinuities, so that it can be compared with the reference.
void add_rays(test::RandomScene& scene, std::size_t count, const reference::Settings* margins) {
    std::mt19937_64 random(73);
    std::uniform_real_distribution<double> aside(-0.4, 0.4);
    for (int attempt = 0; attempt < 2000 && scene.rays.size() < count; ++attempt) {
        const glm::dvec3 actor =
            scene.world.instances[random() % scene.world.instances.size()].world_from_model.translation;
        const glm::dvec3 towards = actor + glm::dvec3(aside(random), aside(random), aside(random));
        const reference::Ray ray{glm::dvec3(0.0), glm::dvec3(glm::vec3(glm::normalize(towards)))};
        if (!margins || test::has_margins(scene.world, *margins, ray, {})) scene.rays.push_back(ray);
    }
}

double compute_normalised_error(const test::GradientGroup& group) {
    double difference = 0.0, size = 0.0;
    for (std::size_t i = 0; i < group.expected.size(); ++i)
        for (std::size_t k = 0; k < group.expected[i].size(); ++k) {
            difference += std::pow(group.actual[i][k] - group.expected[i][k], 2);
            size += std::pow(group.expected[i][k], 2);
        }
    return difference / size;
}

class ManyActors : public test::DeviceTest {
protected:
    /// Evaluates the SH along the ray for a thousand instances of one model, and along
    /// the surfel for a thousand models.
    static ImageModel make_image_model(bool has_models) {
        return {.sh_direction = has_models ? ShDirection::surfel : ShDirection::ray};
    }
};

TEST_F(ManyActors, ImageAndGradientsAgreeWithTheReference) {
    for (const bool has_models : {false, true}) {
        reference::Settings settings;
        settings.image = make_image_model(has_models);
        test::RandomScene scene = make_many_actors(has_models, kAcross * kAcross * kAcross);
        settings.view_origin = scene.view_origin;
        add_rays(scene, 30, &settings);
        ASSERT_EQ(scene.rays.size(), 30u);
        const std::vector<reference::PixelGradient> upstream =
            test::make_random_upstream(scene.rays.size(), 74);
        const std::vector<reference::Pixel> pixels = reference::render(scene.world, settings, scene.rays);
        const reference::Gradients expected =
            reference::backward(scene.world, settings, scene.rays, upstream);
        test::GradientTable table;
        Passes passes(device(), settings.image, scene, upstream, test::make_options(settings.image));
        passes.run();
        const std::vector<shared::RenderedRay> rendered = passes.renderer.last_batch().rendered->download();
        for (std::size_t i = 0; i < scene.rays.size(); ++i) {
            const reference::Pixel& pixel = pixels[i];
            const shared::RenderedRay& r = rendered[i];
            table.add_row("pixel",
                          {pixel.depth, pixel.weight, pixel.intensity, pixel.hit_logit, pixel.drop_logit},
                          {r.depth, r.weight, r.intensity, r.hit_logit, r.drop_logit});
            EXPECT_GT(pixel.hits, 0u);
        }
        test::add_surfel_rows(table, expected.surfels, passes.gradients().surfels.download());
        table.print(has_models ? "1000 models" : "1000 instances of a model");
        for (const auto& [name, group] : table.groups()) {
            // Computes the error over all rows, because a single row has only one or two
            // hits whose terms may cancel.
            EXPECT_LE(compute_normalised_error(group), test::kKernelNmse) << name;
            EXPECT_EQ(group.count_missing_rows(), 0u) << name;
            EXPECT_GT(group.count_nonzero_rows(), 0u) << name;
        }
    }
}

/// The number of launches in an iteration must not depend on the number of models.
TEST_F(ManyActors, AreLaunchedTogether) {
    if (!device().info().timestamps) GTEST_SKIP() << "no timestamps: launches are not counted";
    ActorBoxLoss surfel_loss(device(), {.box = 0.1f});
    const Array<float> terms(device(), kLossTerms, "loss terms");
    const auto launches = [&](int n_actors) {
        test::RandomScene scene = make_many_actors(true, n_actors);
        add_rays(scene, 10, nullptr);
        Passes passes(device(), make_image_model(true), scene,
                      std::vector<reference::PixelGradient>(scene.rays.size()),
                      test::make_options(make_image_model(true)));
        passes.run();  // builds the tree, which takes a number of launches logarithmic in its size
        Stream& stream = passes.renderer.stream();
        stream.reset_times();
        passes.run();
        surfel_loss.add_regularisers(stream, passes.renderer.scene(), {&passes.gradients().surfels, nullptr},
                                     terms);
        stream.submit_and_wait();
        std::map<std::string, std::size_t> counts;
        for (const auto& [kernel, times] : stream.times().milliseconds) counts[kernel] = times.size();
        return counts;
    };
    EXPECT_EQ(launches(1000), launches(2));
}

}  // namespace
}  // namespace relidar
