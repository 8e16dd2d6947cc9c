// SPDX-License-Identifier: Apache-2.0
// Tests image formation against closed forms: a surfel head-on, two surfels at equal
// depth, the stop rule, and the median range. diff/backward/reference_gradient_test.cpp
// compares gradients with differences.
#include <gtest/gtest.h>

#include "render.hpp"

namespace relidar::reference {
namespace {

constexpr double kC0 = 0.28209479177387814;

/// Returns a surfel at (x, 0, 0) that faces the sensor, with constant channel values.
Surfel make_facing_surfel(double x, double opacity, const glm::dvec3& value) {
    Surfel s;
    s.mean = {x, 0, 0};
    s.rotation = {0.5, 0.5, 0.5, 0.5};
    s.log_scale = {std::log(0.5), std::log(0.5)};
    s.opacity_logit = std::log(opacity / (1.0 - opacity));
    for (int c = 0; c < 3; ++c) s.sh[c * kShCoefficients] = (value[c] - 0.5) / kC0;
    return s;
}

World make_world(const std::vector<Surfel>& surfels) {
    return {surfels, {{0, std::uint32_t(surfels.size()), {}}}};
}

struct Case {
    World world;
    Settings settings{};
    Ray ray{};
    Pixel image() const { return render(world, settings, {ray}).front(); }
    Gradients gradient(const PixelGradient& gradient) const {
        return backward(world, settings, {ray}, {gradient});
    }
};

TEST(ReferenceRender, EmptySceneIsBackground) {
    for (const World& world :
         {World{}, make_world({}), make_world({make_facing_surfel(-5, 0.5, {1, 1, 1})})}) {
        const Pixel p = Case{world}.image();
        EXPECT_EQ(p.depth, 0.0);
        EXPECT_EQ(p.weight, 0.0);
        EXPECT_EQ(p.intensity, 0.0);
        EXPECT_EQ(p.hit_logit, 0.0);
        EXPECT_EQ(p.drop_logit, 1.0);
        EXPECT_EQ(p.transmittance, 1.0);
        EXPECT_EQ(p.median_depth, 0.0);
        EXPECT_EQ(p.hits, 0u);
    }
}

TEST(ReferenceRender, OneSurfelHeadOn) {
    const Pixel p = Case{make_world({make_facing_surfel(5, 0.8, {0.3, 2.0, -1.0})})}.image();
    EXPECT_NEAR(p.depth, 4.0, 1e-12);
    EXPECT_NEAR(p.weight, 0.8, 1e-12);
    EXPECT_NEAR(p.intensity, 0.24, 1e-12);
    EXPECT_NEAR(p.hit_logit, 1.6, 1e-12);
    EXPECT_NEAR(p.drop_logit, -0.8 + 0.2, 1e-12);
    EXPECT_NEAR(p.transmittance, 0.2, 1e-12);
    EXPECT_NEAR(p.median_depth, 5.0, 1e-12);
    EXPECT_EQ(p.hits, 1u);
}

TEST(ReferenceRender, LikelihoodOfTheMeasuredRange) {
    Case c{
        make_world({make_facing_surfel(5, 0.8, glm::dvec3(1)), make_facing_surfel(7, 0.5, glm::dvec3(1))})};
    EXPECT_EQ(c.image().likelihood, 0.0) << "nothing was measured";
    c.settings.likelihood_scale_m = 1.0;
    c.ray.measured_m = 7.0;  // the first surfel, 2 m in front, has the weight 1 / 5
    EXPECT_NEAR(c.image().likelihood, 0.8 / 5.0 + 0.2 * 0.5, 1e-12);
    c.settings.likelihood_scale_m = 0.8;
    c.ray.measured_m = 5.0;  // the second surfel, 2 m behind, has the weight 1 / (1 + 6.25)
    EXPECT_NEAR(c.image().likelihood, 0.8 + 0.2 * 0.5 / 7.25, 1e-12);
}

TEST(ReferenceRender, MedianIsWhereTransmittanceCrossesHalf) {
    const auto at = [](double value) { return make_facing_surfel(value, 0.4, glm::dvec3(1)); };
    // T: 1, 0.6, 0.36, 0.216
    EXPECT_NEAR((Case{make_world({at(6), at(4), at(8)})}.image().median_depth), 6.0, 1e-12);
    EXPECT_EQ((Case{make_world({at(6)})}.image().median_depth), 0.0);
}

TEST(ReferenceRender, EqualDepthIsOrderedByInstanceThenSurfel) {
    const Surfel a = make_facing_surfel(5, 0.5, {1, 0, 0}), b = make_facing_surfel(5, 0.5, {0, 1, 0});
    using Ids = std::vector<std::pair<std::uint32_t, std::uint32_t>>;
    const auto ids = [](const World& world) {
        Ids result;
        for (const Hit& hit : BruteForce(world, {}, Precision::double_record).list_hits({}))
            result.emplace_back(hit.instance, hit.surfel);
        return result;
    };
    EXPECT_EQ(ids(make_world({a, b, a})), (Ids{{0, 0}, {0, 1}, {0, 2}}));
    EXPECT_EQ(ids({{a, b}, {{1, 1, {}}, {0, 1, {}}}}), (Ids{{0, 1}, {1, 0}}));
    const Pixel p = Case{make_world({a, b})}.image();
    EXPECT_NEAR(p.intensity, 0.5, 1e-12);
    EXPECT_NEAR(p.hit_logit, 0.25, 1e-12);
}

TEST(ReferenceRender, StopsBeforeTheSurfelThatGoesUnderTheMinimum) {
    std::vector<Surfel> surfels;
    for (int i = 0; i < 6; ++i) surfels.push_back(make_facing_surfel(5 + i, 0.9, glm::dvec3(1)));
    Case c{make_world(surfels)};
    c.settings.image.transmittance_min = 0.5e-3f;
    const Pixel p = c.image();
    // The fourth surfel is not blended, because it would reduce T from 1e-3 to 1e-4,
    // which is below T_min.
    EXPECT_EQ(p.hits, 3u);
    EXPECT_NEAR(p.transmittance, 1e-3, 1e-12);
}

TEST(ReferenceRender, NearPlane) {
    EXPECT_EQ((Case{make_world({make_facing_surfel(0.19, 0.5, glm::dvec3(1))})}.image().hits), 0u);
    EXPECT_EQ((Case{make_world({make_facing_surfel(0.21, 0.5, glm::dvec3(1))})}.image().hits), 1u);
}

TEST(ReferenceRender, ShDirectionInTheModelsFrame) {
    Surfel s = make_facing_surfel(0, 0.8, glm::dvec3(0.5));
    s.sh[kShCoefficients + 3] = 1.0;  // hit logit: -C1 x
    // the model's x axis is the world's y axis
    const Pose turned{glm::angleAxis(kPi / 2, glm::dvec3(0, 0, 1)), {0, 5, 0}};
    Case c{{{s}, {{0, 1, turned}}}, {}, {{0, 0, 0}, {0, 1, 0}}};
    EXPECT_NEAR(c.image().hit_logit, 0.8 * (0.5 - 0.4886025119029199), 1e-12);
    c.settings.image.sh_direction = ShDirection::surfel;
    // The ray views the mean along -x of the world, which is y of the model.
    c.settings.view_origin = {5, 5, 0};
    EXPECT_NEAR(c.image().hit_logit, 0.8 * 0.5, 1e-12);
}

TEST(ReferenceBackward, ClampedIntensityHasNoGradient) {
    const Case c{make_world({make_facing_surfel(5, 0.8, {-0.3, 2.0, 3.0})})};
    EXPECT_EQ(c.image().intensity, 0.0);
    const Gradients d = c.gradient({0, 0, 1, 0, 0});
    for (const double x : d.surfels[0].sh) EXPECT_EQ(x, 0.0);
    EXPECT_EQ(d.surfels[0].opacity_logit, 0.0);
}

}  // namespace
}  // namespace relidar::reference
