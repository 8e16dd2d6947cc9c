// SPDX-License-Identifier: Apache-2.0
// Tests scene/activate and scene/activate_vjp. Compares each element of a record with the
// reference activations and their central differences.
#include <random>

#include <relidar/base/error.hpp>
#include <relidar/scene/device_scene.hpp>

#include "gpu/stream.hpp"
#include "scene/shared/scene.h"

#include "../support/device.hpp"
#include "../support/floats.hpp"
#include "../support/gradient_check.hpp"
#include "../support/random_scene.hpp"
#include "../support/surfels.hpp"

namespace relidar {
namespace {

// number of background surfels, not a multiple of the workgroup size
constexpr std::uint32_t kOfBackground = 70;
constexpr double kPhase = 0.3;  // phase of the actor's gait, turns

/// Parameters: primitive, whether harmonics are read as on a GPU, whether the actor
/// walks.
class Activate : public test::DeviceTest,
                 public testing::WithParamInterface<std::tuple<PrimitiveType, bool, bool>> {
protected:
    PrimitiveType primitive() const { return std::get<0>(GetParam()); }
    bool stages_harmonics() const { return std::get<1>(GetParam()); }
    SurfelParameterSet parameters() const { return {primitive(), bends()}; }
    bool bends() const { return std::get<2>(GetParam()); }

    /// Returns enough surfels for more than two workgroups of 64. If the actor walks, the
    /// background surfels have a gait too, which must be ignored.
    std::vector<reference::Surfel> make_some_surfels() const {
        test::RandomSceneOptions options;
        options.seed = 8;
        options.background_surfels = 150;
        options.primitive = primitive();
        std::vector<reference::Surfel> surfels = test::make_random_scene(options, {}).world.surfels;
        std::mt19937_64 random(21);
        std::uniform_real_distribution<float> u(-1.0f, 1.0f);
        for (reference::Surfel& s : surfels) {
            if (!bends()) break;
            s.gait_phase = u(random);
            s.gait_sharpness = 0.8f * u(random);
            s.gait_swing = {0.5f * u(random), 0.5f * u(random), 0.5f * u(random)};
        }
        return surfels;
    }
    /// Returns a surfel as on_device() places it: on a walking actor, moved with its
    /// limb.
    reference::Surfel in_scene(const reference::Surfel& surfel, std::size_t index) const {
        return bends() && index >= kOfBackground ? reference::move_to_phase(surfel, kPhase) : surfel;
    }

    ImageModel image_model(int sh_degree) const {
        ImageModel model;
        model.primitive = primitive();
        model.sh_direction = ShDirection::surfel;
        model.sh_degree = sh_degree;
        return model;
    }
    /// Uploads two models, both placed at the origin.
    std::unique_ptr<DeviceScene> on_device(const Surfels& surfels) {
        Scene scene = wrap_background(surfels);
        const auto n = static_cast<std::uint32_t>(surfels.size());
        scene.models = {{"background", 0, kOfBackground}, {"actor", kOfBackground, n - kOfBackground}};
        if (bends()) scene.models[1].stride_m = 1.4f;
        scene.instances.push_back({1, "actor"});
        auto on_device = std::make_unique<DeviceScene>(device(), scene, stages_harmonics());
        Stream stream(device());
        // full turns of the phase must not matter
        on_device->stage_poses(stream, {{}, {.world_from_model = {}, .phase = kPhase + 3.0}});
        stream.submit_and_wait();
        return on_device;
    }
};
INSTANTIATE_TEST_SUITE_P(PrimitivesAndAccess, Activate,
                         testing::Combine(testing::Values(PrimitiveType::surfel, PrimitiveType::gaussian),
                                          testing::Bool(), testing::Bool()));

/// Returns the floats of a record in double, in the order of
/// shaders/scene/shared/scene.h.
std::vector<double> compute_record(const reference::Surfel& surfel, const glm::dvec3& view_origin,
                                   int sh_degree) {
    const reference::DoubleRecord r = reference::make_record(surfel);
    const glm::dvec3 c = reference::evaluate_sh(surfel, glm::normalize(surfel.mean - view_origin), sh_degree);
    return {r.mean.x,   r.mean.y,           r.mean.z,   r.sigma,    r.axis_u.x, r.axis_u.y,
            r.axis_u.z, std::max(c.x, 0.0), r.axis_v.x, r.axis_v.y, r.axis_v.z, c.y,
            r.normal.x, r.normal.y,         r.normal.z, c.z};
}

/// Returns the tolerance of each element of a record: Vulkan's error bounds of exp and
/// division, the rounding of a rotation matrix, and 2e-6 of summed values.
std::vector<double> compute_record_tolerance(const reference::Surfel& surfel,
                                             const std::vector<double>& expected) {
    // On the diagonal, the element is 1 minus twice a sum of two products of q / |q|.
    // Each factor has the error of an inverse square root (2 units) and of 6 roundings.
    constexpr double kElement =
        2.0 * 2.0 * (2.0 * test::kUnit + 6.0 * test::kRounding) + 4.0 * test::kRounding;
    const double log_scale[] = {surfel.log_scale.x, surfel.log_scale.y, surfel.log_scale_w.value_or(0.0)};
    std::vector<double> tolerance;
    for (const double value : expected) tolerance.push_back(2e-6 * (1.0 + std::abs(value)));
    for (std::size_t axis = 0; axis < 3; ++axis)
        for (std::size_t k = 4 * axis + 4; k < 4 * axis + 7; ++k)
            tolerance[k] = kElement * std::exp(-log_scale[axis]) +
                           std::abs(expected[k]) * (test::compute_exp_error(log_scale[axis]) + test::kUnit);
    tolerance[3] = test::compute_sigmoid_error(expected[3], surfel.opacity_logit) + test::kUnit;
    // Vulkan allows errors of 2^-11 in sine and cosine within half a turn, so the
    // tolerance of walking surfels is larger.
    for (std::size_t k = 0; k < 3; ++k) tolerance[k] += std::abs(surfel.gait_swing[int(k)]) / 2048.0;
    tolerance[3] += surfel.gait_sharpness * surfel.gait_sharpness / 2048.0;
    return tolerance;
}

TEST_P(Activate, RecordsAgreeWithReference) {
    const std::vector<reference::Surfel> surfels = make_some_surfels();
    const glm::vec3 view(0.3f, -0.2f, 0.1f);
    const std::unique_ptr<DeviceScene> scene = on_device(test::to_surfels(surfels));
    for (const int degree : {3, 1}) {
        Stream stream(device());
        scene->activate(stream, image_model(degree), view);
        stream.submit_and_wait();
        const std::vector<float> actual = test::to_floats(scene->surfel_records().download());
        for (std::size_t i = 0; i < surfels.size(); ++i) {
            const std::vector<double> expected =
                compute_record(in_scene(surfels[i], i), glm::dvec3(view), degree);
            const std::vector<double> tolerance = compute_record_tolerance(in_scene(surfels[i], i), expected);
            for (std::size_t k = 0; k < 16; ++k)
                EXPECT_NEAR(actual[16 * i + k], expected[k], tolerance[k]) << "surfel " << i << " lane " << k;
        }
    }
}

/// Kernels search for the model of a surfel, which needs consecutive ranges.
TEST_P(Activate, ModelsThatAreNoConsecutiveRangesAreRefused) {
    Scene scene = wrap_background(test::to_surfels(make_some_surfels()));
    const auto n = static_cast<std::uint32_t>(scene.surfels.size());
    using Ranges = std::vector<SurfelModel>;
    for (const Ranges& ranges :
         {Ranges{{"a", 0, 70}, {"b", 71, n - 71}}, Ranges{{"a", 0, 70}, {"b", 69, n - 69}},
          Ranges{{"b", 70, n - 70}, {"a", 0, 70}}, Ranges{{"a", 0, n - 1}}}) {
        scene.models = ranges;
        EXPECT_THROW(DeviceScene(device(), scene), DataError);
    }
}

TEST_P(Activate, HarmonicsThatAreNoNumbersMakeASurfelInvisible) {
    Surfels surfels = test::to_surfels(make_some_surfels());
    surfels.sh[kShFloats * 5 + 17] = std::numeric_limits<float>::quiet_NaN();
    surfels.sh[kShFloats * 99 + 3] = std::numeric_limits<float>::infinity();
    // this coefficient is above the active SH degree
    surfels.sh[kShFloats * 7 + 47] = std::numeric_limits<float>::quiet_NaN();
    const std::unique_ptr<DeviceScene> scene = on_device(surfels);
    Stream stream(device());
    scene->activate(stream, image_model(1), glm::vec3(0.0f));
    stream.submit_and_wait();
    const std::vector<shared::SurfelRecord> records = scene->surfel_records().download();
    for (std::size_t i = 0; i < surfels.size(); ++i)
        EXPECT_EQ(records[i].opacity == 0.0f, i == 5 || i == 99) << "surfel " << i;
}

/// Every third surfel has the gradient 0.
std::vector<float> make_record_gradients(std::size_t count) {
    std::mt19937_64 random(3);
    std::normal_distribution<float> normal;
    std::vector<float> d_records;
    for (std::size_t i = 0; i < count; ++i)
        for (std::size_t k = 0; k < 16; ++k) d_records.push_back(i % 3 == 1 ? 0.0f : normal(random));
    return d_records;
}

/// Adds two rows for each parameter of surfel `index`: central differences of `terms`
/// with respect to the parameter, and the gradient of the kernel.
template <class Terms>
void add_surfel_rows(test::GradientTable& table, reference::Surfel& surfel, const Surfels& actual,
                     std::size_t index, int degree, bool bends, Terms&& terms) {
    const auto add = [&](const char* name, double* values, const float* gradient, int count, auto... step) {
        table.add_row(name, test::compute_central_differences(values, count, terms, step...),
                      std::vector<double>(gradient, gradient + count));
    };
    add("mean", &surfel.mean.x, &actual.mean[index].x, 3);
    add("rotation", &surfel.rotation.x, &actual.rotation[index].x, 4);
    add("log_scale", &surfel.log_scale.x, &actual.log_scale[index].x, 2);
    if (surfel.log_scale_w) add("log_scale_w", &*surfel.log_scale_w, &actual.log_scale_w[index], 1);
    add("opacity_logit", &surfel.opacity_logit, &actual.opacity_logit[index], 1);
    if (bends) {
        add("gait phase", &surfel.gait_phase, &actual.gait[index].phase, 1);
        add("gait sharpness", &surfel.gait_sharpness, &actual.gait[index].sharpness, 1);
        add("gait swing", &surfel.gait_swing.x, &actual.gait[index].swing.x, 3);
    }
    const int active = (degree + 1) * (degree + 1);
    for (int first = 0; first < kShFloats; first += kShCoefficients)
        add("sh", surfel.sh.data() + first, actual.sh.data() + index * kShFloats + std::size_t(first), active,
            test::kLogitStep);
}

TEST_P(Activate, VjpAgreesWithDifferencesOfReference) {
    std::vector<reference::Surfel> surfels = make_some_surfels();
    const glm::vec3 view(0.3f, -0.2f, 0.1f);
    glm::dvec3 exact_view(view);
    const std::vector<float> d_records = make_record_gradients(surfels.size());
    const std::unique_ptr<DeviceScene> scene = on_device(test::to_surfels(surfels));
    const auto n = static_cast<std::uint32_t>(surfels.size());
    for (const int degree : {3, 1}) {
        Stream stream(device());
        SurfelArrays d_surfels(device(), n, "gradient", parameters());
        Array<std::uint32_t, shared::TouchedSurfels> touched(device(), n, "touched");
        Array<float, shared::ViewGradients> d_view(device(), 3 * surfels.size(), "view gradient");
        const Array<float, shared::RecordGradients> upstream(device(), std::span<const float>(d_records),
                                                             "record gradient");
        scene->activate_vjp(stream, image_model(degree), view, {&upstream, &d_surfels, &touched, &d_view});
        stream.submit_and_wait();
        const Surfels actual = d_surfels.download();
        const std::vector<std::uint32_t> marks = touched.download();
        for (std::size_t i = 0; i < n; ++i) EXPECT_EQ(marks[i], i % 3 == 1 ? 0u : 1u);

        const std::vector<float> views = d_view.download();
        test::GradientTable table;
        for (std::size_t i = 0; i < surfels.size(); ++i) {
            const auto terms = [&] {
                std::vector<double> sum = compute_record(in_scene(surfels[i], i), exact_view, degree);
                for (std::size_t k = 0; k < 16; ++k) sum[k] *= d_records[16 * i + k];
                return sum;
            };
            table.add_row("view origin", test::compute_central_differences(&exact_view.x, 3, terms),
                          std::vector<double>(views.data() + 3 * i, views.data() + 3 * i + 3));
            add_surfel_rows(table, surfels[i], actual, i, degree, bends(), terms);
        }
        table.print("activation on " + device().info().name);
        for (const auto& [name, group] : table.groups()) {
            EXPECT_LE(group.compute_worst_error(), test::kKernelGradient) << name;
            EXPECT_EQ(group.count_missing_rows(), 0u) << name;
        }
    }
}

TEST_P(Activate, VjpLeavesUntouchedRowsWhereTheyAreNotWanted) {
    const std::vector<reference::Surfel> surfels = make_some_surfels();
    const std::vector<float> d_records = make_record_gradients(surfels.size());
    const auto n = static_cast<std::uint32_t>(surfels.size());
    const std::unique_ptr<DeviceScene> scene = on_device(test::to_surfels(surfels));
    SurfelArrays d_surfels(device(), n, "gradient", parameters());
    Surfels before;
    before.resize(n, parameters());
    std::fill(before.sh.begin(), before.sh.end(), 7.0f);
    std::fill(before.mean.begin(), before.mean.end(), glm::vec3(7.0f));
    d_surfels.upload(before);
    Array<std::uint32_t, shared::TouchedSurfels> touched(device(), n, "touched");
    const Array<float, shared::RecordGradients> upstream(device(), std::span<const float>(d_records),
                                                         "record gradient");
    Stream stream(device());
    scene->activate_vjp(stream, image_model(3), glm::vec3(0.0f),
                        {&upstream, &d_surfels, &touched, nullptr, false});
    stream.submit_and_wait();
    const Surfels after = d_surfels.download();
    for (std::size_t i = 0; i < n; ++i) {
        EXPECT_EQ(after.mean[i] == glm::vec3(7.0f), i % 3 == 1) << "surfel " << i;
        for (std::size_t k = 0; k < kShFloats; ++k)
            EXPECT_EQ(after.sh[kShFloats * i + k] == 7.0f, i % 3 == 1)
                << "surfel " << i << " coefficient " << k;
    }
}

/// Compares the derivatives over a list of marked surfels with those over all surfels.
/// Some marked surfels have no gradient. Unmarked surfels must not be read.
TEST_P(Activate, VjpOverAListIsThatOverAll) {
    const std::vector<reference::Surfel> surfels = make_some_surfels();
    const auto n = static_cast<std::uint32_t>(surfels.size());
    std::vector<float> d_records = make_record_gradients(n);
    std::vector<std::uint32_t> marks;
    for (std::uint32_t i = 0; i < n; ++i) marks.push_back(i % 5 != 2);
    for (std::uint32_t i = 0; i < n; ++i)
        if (marks[i] == 0u) std::fill_n(d_records.begin() + 16 * i, 16, 0.0f);
    const std::unique_ptr<DeviceScene> placed = on_device(test::to_surfels(surfels));
    EXPECT_EQ(placed->can_skip_surfels(), !stages_harmonics());
    const auto run = [&](bool is_marked) {
        const Array<float, shared::RecordGradients> upstream(device(), std::span<const float>(d_records),
                                                             "record gradient");
        SurfelArrays d_surfels(device(), n, "gradient", parameters());
        Array<std::uint32_t, shared::TouchedSurfels> touched(device(), std::span<const std::uint32_t>(marks),
                                                             "touched");
        Array<float, shared::ViewGradients> d_view(device(), 3 * surfels.size(), "view gradient");
        Stream stream(device());
        d_surfels.fill_zero(stream);
        stream.fill(d_view);
        placed->activate_vjp(stream, image_model(3), glm::vec3(0.3f, -0.2f, 0.1f),
                             {&upstream, &d_surfels, &touched, &d_view, false, is_marked});
        stream.submit_and_wait();
        return std::tuple(d_surfels.download(), touched.download(), d_view.download());
    };
    const auto [surfels_of_all, touched_of_all, view_of_all] = run(false);
    if (placed->can_skip_surfels())  // gradients of unmarked surfels, which must be ignored
        for (std::uint32_t i = 0; i < n; ++i)
            if (marks[i] == 0u) d_records[16 * i] = 1.0f;
    const auto [surfels_listed, touched_listed, view_listed] = run(true);
    EXPECT_EQ(touched_listed, touched_of_all);
    EXPECT_EQ(view_listed, view_of_all);
    for (const SurfelParameterGroup& group : list_groups(parameters())) {
        const std::span<const float> actual = group.values(surfels_listed),
                                     expected = group.values(surfels_of_all);
        EXPECT_TRUE(std::ranges::equal(actual, expected)) << group.name;
    }
}

class TouchedRows : public test::DeviceTest {};

/// Checks that the list contains exactly the surfels with a gradient, each surfel once.
TEST_F(TouchedRows, AreListed) {
    const Kernel<shared::ListTouchedParams> kernel(device(), "scene/list_touched");
    std::mt19937 random(3);
    for (const std::uint32_t n : {1u, 15u, 16u, 17u, 1000u, 70001u}) {
        std::vector<std::uint32_t> touched(n), expected;
        for (std::uint32_t row = 0; row < n; ++row) {
            touched[row] = random() % 3 == 0 || row + 1 == n;
            if (touched[row] != 0u) expected.push_back(row);
        }
        const Array<std::uint32_t, shared::TouchedSurfels> on_device(
            device(), std::span<const std::uint32_t>(touched), "touched");
        const Array<std::uint32_t, shared::TouchedRows> rows(device(), n, "rows");
        const Array<std::uint32_t, shared::TouchedCount> count(device(), std::vector<std::uint32_t>{0u},
                                                               "count");
        Stream stream(device());
        run(stream, kernel, (n + RELIDAR_LIST_STRETCH - 1) / RELIDAR_LIST_STRETCH,
            {.touched = on_device.address(), .rows = rows.address(), .count = count.address(), .n_rows = n});
        stream.submit_and_wait();
        ASSERT_EQ(count.download()[0], expected.size());
        std::vector<std::uint32_t> listed = rows.download();
        listed.resize(expected.size());
        std::sort(listed.begin(), listed.end());
        EXPECT_EQ(listed, expected) << n;
    }
}

TEST(KdOrder, IsAPermutationThatHalvesTheLongestAxis) {
    std::mt19937_64 random(4);
    std::uniform_real_distribution<float> u(0.0f, 1.0f);
    std::vector<glm::vec3> points;
    for (int i = 0; i < 1001; ++i) points.push_back({10.0f * u(random), u(random), u(random)});
    const std::vector<std::uint32_t> order = kd_tree_order(points);
    std::vector<std::uint32_t> sorted = order;
    std::sort(sorted.begin(), sorted.end());
    for (std::uint32_t i = 0; i < sorted.size(); ++i) ASSERT_EQ(sorted[i], i);
    const std::size_t middle = points.size() / 2;
    float below = 0.0f, above = 1e9f;
    for (std::size_t i = 0; i < points.size(); ++i)
        (i < middle ? below = std::max(below, points[order[i]].x)
                    : above = std::min(above, points[order[i]].x));
    EXPECT_LE(below, above);
}

}  // namespace
}  // namespace relidar
