// SPDX-License-Identifier: Apache-2.0
// scene/activate and scene/activate_vjp alone, against the reference activations and their differences, record lane by record lane;
// kd order; background extent.
#include <algorithm>
#include <cmath>
#include <random>

#include "../support/device.hpp"
#include "../support/gradient_check.hpp"
#include "../support/random_scene.hpp"
#include "../support/surfels.hpp"

namespace relidar {
namespace {

/// In both primitives.
class Activate : public test::DeviceTest, public testing::WithParamInterface<Primitive> {};
INSTANTIATE_TEST_SUITE_P(Primitives, Activate, testing::Values(Primitive::surfel, Primitive::gaussian));

/// The 16 floats of a record in double, as shaders/shared/scene.h orders them.
std::vector<double> record_of(const reference::Surfel& s, const glm::dvec3& view_origin) {
    const reference::DoubleRecord r = reference::make_record(s);
    const glm::dvec3 c = reference::sh_values(s, glm::normalize(s.mean - view_origin), 3);
    return {r.mean.x, r.mean.y, r.mean.z, r.sigma, r.axis_u.x, r.axis_u.y, r.axis_u.z, std::max(c.x, 0.0),
            r.axis_v.x, r.axis_v.y, r.axis_v.z, c.y, r.normal.x, r.normal.y, r.normal.z, c.z};
}

std::vector<reference::Surfel> some_surfels(Primitive primitive) {
    test::RandomSceneOptions options;
    options.seed = 8;
    options.primitive = primitive;
    return test::make_random_scene(options, {}).world.surfels;
}

TEST_P(Activate, RecordsAgreeWithReference) {
    const std::vector<reference::Surfel> surfels = some_surfels(GetParam());
    const glm::vec3 view(0.3f, -0.2f, 0.1f);
    ImageModel model;
    model.primitive = GetParam();
    model.sh_direction = ShDirection::surfel;
    Stream stream(device());
    DeviceScene scene(device(), make_background_scene(test::to_surfels(surfels)));
    scene.activate(stream, model, view);
    stream.finish();
    const std::vector<float> actual = scene.records().download();
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        const std::vector<double> expected = record_of(surfels[i], glm::dvec3(view));
        for (std::size_t k = 0; k < 16; ++k) EXPECT_NEAR(actual[16 * i + k], expected[k], 2e-6 * (1.0 + std::abs(expected[k]))) << "surfel " << i << " lane " << k;
    }
}

TEST_P(Activate, VjpAgreesWithDifferencesOfReference) {
    std::vector<reference::Surfel> surfels = some_surfels(GetParam());
    const glm::vec3 view(0.3f, -0.2f, 0.1f);
    glm::dvec3 seen_from(view);
    std::mt19937_64 random(3);
    std::normal_distribution<float> normal;
    std::vector<float> d_records;
    for (std::size_t i = 0; i < 16 * surfels.size(); ++i) d_records.push_back(normal(random));
    for (std::size_t k = 0; k < 16; ++k) d_records[16 + k] = 0.0f;   // surfel 1 has no gradient
    ImageModel model;
    model.sh_direction = ShDirection::surfel;
    Stream stream(device());
    const auto n = static_cast<std::uint32_t>(surfels.size());
    DeviceScene scene(device(), make_background_scene(test::to_surfels(surfels)));
    SurfelArrays d_surfels(device(), n, "gradient", GetParam());
    Array<std::uint32_t> touched(device(), n, "touched");
    Array<float> d_view(device(), 3 * surfels.size(), "view gradient");
    const Array<float> upstream(device(), std::span<const float>(d_records), "record gradient");
    scene.activate_vjp(stream, model, view, {&upstream, &d_surfels, &touched, &d_view});
    stream.finish();
    const Surfels actual = d_surfels.download();
    EXPECT_EQ(touched.download()[1], 0u);
    EXPECT_EQ(glm::length(actual.mean[1]), 0.0f);
    if (GetParam() == Primitive::gaussian) {
        EXPECT_EQ(actual.log_scale_w[1], 0.0f);
    }

    const std::vector<float> views = d_view.download();
    test::GradientTable table;
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        const auto terms = [&] {
            std::vector<double> sum = record_of(surfels[i], seen_from);
            for (std::size_t k = 0; k < 16; ++k) sum[k] *= d_records[16 * i + k];
            return sum;
        };
        const auto row = [](const float* v, int count) { return std::vector<double>(v, v + count); };
        table.add_row("view origin", test::central_differences(&seen_from.x, 3, terms), row(views.data() + 3 * i, 3));
        table.add_row("mean", test::central_differences(&surfels[i].mean.x, 3, terms), row(&actual.mean[i].x, 3));
        table.add_row("rotation", test::central_differences(&surfels[i].rotation.x, 4, terms), row(&actual.rotation[i].x, 4));
        table.add_row("log_scale", test::central_differences(&surfels[i].log_scale.x, 2, terms), row(&actual.log_scale[i].x, 2));
        if (surfels[i].log_scale_w) table.add_row("log_scale_w", test::central_differences(&*surfels[i].log_scale_w, 1, terms), row(&actual.log_scale_w[i], 1));
        table.add_row("opacity_logit", test::central_differences(&surfels[i].opacity_logit, 1, terms), row(&actual.opacity_logit[i], 1));
        table.add_row("sh", test::central_differences(surfels[i].sh.data(), kShFloats, terms, test::kLogitStep), row(actual.sh.data() + i * kShFloats, kShFloats));
    }
    table.print("activation on " + device().info().name);
    for (const auto& [name, group] : table.groups()) {
        EXPECT_LE(group.worst_error(), test::kKernelGradient) << name;
        EXPECT_EQ(group.missing_rows(), 0u) << name;
    }
}

TEST(KdOrder, IsAPermutationThatHalvesTheLongestAxis) {
    std::mt19937_64 random(4);
    std::uniform_real_distribution<float> u(0.0f, 1.0f);
    std::vector<glm::vec3> points;
    for (int i = 0; i < 1001; ++i) points.push_back({10.0f * u(random), u(random), u(random)});
    const std::vector<std::uint32_t> order = kd_order(points);
    std::vector<std::uint32_t> sorted = order;
    std::sort(sorted.begin(), sorted.end());
    for (std::uint32_t i = 0; i < sorted.size(); ++i) ASSERT_EQ(sorted[i], i);
    const std::size_t middle = points.size() / 2;
    float below = 0.0f, above = 1e9f;
    for (std::size_t i = 0; i < points.size(); ++i) (i < middle ? below = std::max(below, points[order[i]].x) : above = std::min(above, points[order[i]].x));
    EXPECT_LE(below, above);
}

}  // namespace
}  // namespace relidar
