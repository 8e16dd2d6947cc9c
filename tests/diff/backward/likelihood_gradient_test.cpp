// SPDX-License-Identifier: Apache-2.0
// Tests the likelihood of measured ranges (M12) from end to end.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include <glm/gtc/quaternion.hpp>

#include <relidar/diff/loss.hpp>

#include "base/parallel.hpp"

#include "../../reference/loss.hpp"
#include "../../support/surfels.hpp"
#include "passes.hpp"

namespace relidar {
namespace {

using test::GradientTable;
using test::lanes;

constexpr int kRows = 6, kColumns = 7;

glm::dvec4 make_facing_rotation_of_wall(std::mt19937_64& random, double tilt) {
    std::normal_distribution<double> normal;
    // Rotates the normal to -x.
    const glm::dquat to_sensor = glm::angleAxis(-1.5707963267948966, glm::dvec3(0.0, 1.0, 0.0));
    const glm::dquat q = glm::angleAxis(tilt * normal(random),
                                        glm::normalize(glm::dvec3(0.0, normal(random), normal(random)))) *
                         to_sensor;
    return {q.w, q.x, q.y, q.z};
}

/// Makes a wall of tilted surfels, faint surfels in front of the wall, and an instance of
/// a model with four surfels. The sensor renders them as an image.
test::RandomScene make_wall(std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    std::vector<reference::Surfel> surfels;
    const auto add = [&](const glm::dvec3& mean, double size, double opacity) {
        reference::Surfel s;
        s.mean = mean + 0.08 * glm::dvec3(unit(random), unit(random), unit(random));
        s.rotation = make_facing_rotation_of_wall(random, 0.2);
        s.log_scale = glm::dvec2(std::log(size * (1.0 + 0.2 * unit(random))),
                                 std::log(size * (1.0 + 0.2 * unit(random))));
        s.opacity_logit = std::log(opacity / (1.0 - opacity));
        for (int c = 0; c < kShChannels; ++c)
            s.sh[std::size_t(c * kShCoefficients)] = 0.5 * unit(random) + (c == 0 ? 1.0 : 0.0);
        surfels.push_back(s);
    };
    for (int y = -1; y <= 1; ++y)
        for (int z = -1; z <= 1; ++z) add({6.0, 0.8 * y, 0.8 * z}, 0.7, 0.6);
    for (int i = 0; i < 3; ++i) add({5.4, 0.6 * unit(random), 0.6 * unit(random)}, 0.5, 0.25);
    for (int i = 0; i < 4; ++i) add({0.2 * unit(random), 0.4 * unit(random), 0.4 * unit(random)}, 0.4, 0.5);
    test::RandomScene scene;
    scene.world.surfels = test::to_reference(test::to_surfels(surfels));
    scene.world.instances = {{0, 12, {}},
                             {12, 4, {glm::angleAxis(0.3, glm::dvec3(0.0, 0.6, 0.8)), {5.7, 0.2, -0.2}}}};
    scene.view_origin = glm::dvec3(glm::vec3(0.1, 0.05, 0.0));
    for (int i = 0; i < kRows * kColumns; ++i) {
        const glm::dvec3 d(1.0, -0.04 * (i % kColumns - 3), -0.04 * (i / kColumns - 2.5));
        scene.rays.push_back({glm::dvec3(glm::vec3(0.0, 0.002 * (i % kColumns), 0.0)),
                              glm::dvec3(glm::vec3(glm::normalize(d)))});
    }
    return scene;
}

test::RandomScene make_smooth_wall(const reference::Settings& settings) {
    // The minimum distances to discontinuities are smaller than in other tests, so that a
    // seed with 42 valid rays exists. They are still much larger than the steps of the
    // differences.
    const test::Margins margins{.log_alpha = 5e-3, .separation_m = 5e-4, .log_stop = 5e-3};
    for (std::uint64_t seed = 1; seed < 5000; ++seed) {
        const test::RandomScene scene = make_wall(seed);
        reference::Settings s = settings;
        s.view_origin = scene.view_origin;
        if (std::all_of(scene.rays.begin(), scene.rays.end(), [&](const reference::Ray& ray) {
                return test::has_margins(scene.world, s, ray, margins);
            }))
            return scene;
    }
    throw std::runtime_error("smooth_wall: no seed keeps the margins");
}

struct WallProblem {
    reference::Settings settings;
    test::RandomScene scene = make_smooth_wall(settings);
    LossWeights weights;
    std::vector<reference::Target> targets;

    explicit WallProblem(const LossWeights& w) : weights(w) {
        settings.view_origin = scene.view_origin;
        std::mt19937_64 random(7);
        std::uniform_real_distribution<double> unit(0.0, 1.0);
        for (const reference::Pixel& p : pixels())
            targets.push_back(
                {float(p.depth / p.weight + (unit(random) < 0.5 ? -0.1 : 0.1)), float(0.9 * unit(random))});
        targets[10].range_m = 0.0;  // dropped
        settings.likelihood_scale_m = double(weights.likelihood_scale_m);
        for (std::size_t k = 0; k < targets.size(); ++k) scene.rays[k].measured_m = targets[k].range_m;
    }

    std::vector<reference::Pixel> pixels() const {
        const reference::BruteForce brute(scene.world, settings.image, reference::Precision::double_record);
        std::vector<reference::Pixel> result;
        for (const reference::Ray& ray : scene.rays)
            result.push_back(reference::render(scene.world, brute, settings, ray, 16));
        return result;
    }
    std::vector<double> terms() const {
        const std::vector<reference::Pixel> all = pixels();
        std::vector<double> result;
        result.push_back(evaluate_loss(all, targets, {weights.depth, weights.intensity, weights.drop},
                                       reference::DepthKind::normalised)
                             .total);
        result.push_back(double(weights.likelihood) *
                         compute_likelihood_loss(all, targets, double(weights.likelihood_floor)));
        return result;
    }
};

RendererOptions make_options(const LossWeights& weights, std::uint32_t keep_hits) {
    RendererOptions options = test::make_options({});
    if (weights.likelihood > 0.0f)
        options.trace.likelihood = RangeLikelihoodKernel{weights.likelihood_scale_m};
    options.keep_hits = keep_hits;
    return options;
}

struct DevicePasses : test::Passes {
    std::vector<std::unique_ptr<Loss>> losses;
    Array<float> loss_terms;
    double n_returned = 0.0;

    DevicePasses(Device& d, const WallProblem& problem, std::uint32_t keep_hits,
                 const BackwardOptions& options)
        : Passes(d, problem.settings.image, problem.scene,
                 std::vector<reference::PixelGradient>(problem.scene.rays.size()),
                 make_options(problem.weights, keep_hits), options),
          losses(make_losses(d, problem.weights, std::uint32_t(problem.scene.rays.size()))),
          loss_terms(d, std::vector<float>(kLossTerms, 0.0f), "terms") {
        std::vector<DeviceTarget> t;
        for (const reference::Target& target : problem.targets)
            t.push_back({float(target.range_m), float(target.intensity), 1.0f});
        targets.upload(t);
        for (const reference::Target& target : problem.targets) n_returned += target.range_m > 0.0;
    }
    void run_all() {
        const TargetBatch measured{
            &targets, 0, 1, kRows * kColumns, n_returned, double(kRows * kColumns), {kRows, kColumns, false}};
        run_forward();
        for (const std::unique_ptr<Loss>& loss : losses)
            loss->record_ray_losses(renderer.stream(), differentiable.get_last_rendered_batch(), measured,
                                    loss_terms);
        differentiable.record_backward_pass();
        renderer.stream().submit_and_wait();
    }
};

/// Computes the expected gradient rows by central differences, with the names and order
/// of `collect_actual_rows`.
std::vector<std::pair<std::string, std::vector<double>>> compute_expected_rows(WallProblem& problem) {
    std::vector<std::pair<std::string, std::vector<double>>> rows;
    const auto terms = [&] { return problem.terms(); };
    const auto add = [&](const char* name, double* value, int count, double step = test::kDifferenceStep) {
        rows.emplace_back(name, test::compute_central_differences(value, count, terms, step));
    };
    for (reference::Surfel& s : problem.scene.world.surfels) {
        add("mean", &s.mean.x, 3);
        add("rotation", &s.rotation.x, 4);
        add("log_scale", &s.log_scale.x, 2);
        add("opacity_logit", &s.opacity_logit, 1, test::kLogitStep);
    }
    for (reference::Ray& ray : problem.scene.rays) {
        add("ray origin", &ray.origin.x, 3);
        add("ray direction", &ray.direction.x, 3, test::kAngleStep);
    }
    const auto add_twist = [&](const char* name,
                               const std::function<void(const glm::dvec3&, const glm::dvec3&)>& move) {
        glm::dvec3 v(0.0), w(0.0);
        const auto moved = [&] {
            move(v, w);
            return problem.terms();
        };
        rows.emplace_back(std::string(name) + " translation",
                          test::compute_central_differences(&v.x, 3, moved));
        rows.emplace_back(std::string(name) + " rotation",
                          test::compute_central_differences(&w.x, 3, moved, test::kAngleStep));
        move(glm::dvec3(0.0), glm::dvec3(0.0));
    };
    for (reference::Placement& placed : problem.scene.world.instances) {
        const Pose start = placed.world_from_model;
        add_twist("pose", [&](const glm::dvec3& vector, const glm::dvec3& w) {
            placed.world_from_model = {test::make_rotation_by(w) * start.rotation,
                                       start.translation + vector};
        });
    }
    const std::vector<reference::Ray> rays = problem.scene.rays;
    add_twist("sensor", [&](const glm::dvec3& vector, const glm::dvec3& w) {
        for (std::size_t i = 0; i < rays.size(); ++i)
            problem.scene.rays[i] = {
                problem.settings.view_origin +
                    test::make_rotation_by(w) * (rays[i].origin - problem.settings.view_origin) + vector,
                test::make_rotation_by(w) * rays[i].direction, rays[i].measured_m};
    });
    return rows;
}

std::vector<std::vector<double>> collect_actual_rows(const DeviceGradients& gradients) {
    std::vector<std::vector<double>> rows;
    const Surfels s = gradients.surfels.download();
    for (std::size_t i = 0; i < s.size(); ++i)
        for (const std::vector<double>& row : {lanes(s.mean[i], 3), lanes(s.rotation[i], 4),
                                               lanes(s.log_scale[i], 2), lanes(&s.opacity_logit[i], 1)})
            rows.push_back(row);
    const auto add = [&](const Array<float>& array) {
        const std::vector<float> values = array.download();
        for (std::size_t k = 0; k < values.size(); k += 3) rows.push_back(lanes(&values[k], 3));
    };
    add(gradients.rays);
    add(gradients.poses);
    add(gradients.sensor);
    return rows;
}

using Rows = std::vector<std::pair<std::string, std::vector<double>>>;

/// Returns the same problem with the largest errors that Vulkan allows for exp and
/// division, each with a random sign. The errors apply to the exp of scales and to the
/// sigmoid of opacities. They also apply to the exp of hits one standard deviation from
/// the mean, and to the division that computes distances along a ray.
WallProblem rounded(const WallProblem& problem, std::uint64_t seed) {
    WallProblem moved = problem;
    std::mt19937_64 random(seed);
    const auto sign = [&] { return random() % 2 == 0 ? -1.0 : 1.0; };
    for (reference::Surfel& s : moved.scene.world.surfels) {
        const double opacity = 1.0 / (1.0 + std::exp(-s.opacity_logit));
        // relative error
        const double alpha =
            test::compute_sigmoid_error(opacity, s.opacity_logit) / opacity + test::compute_exp_error(0.5);
        s.opacity_logit += sign() * alpha / (1.0 - opacity);
        for (int k = 0; k < 2; ++k) s.log_scale[k] += sign() * test::compute_exp_error(s.log_scale[k]);
    }
    constexpr double kWall_m = 6.0;
    for (reference::Ray& ray : moved.scene.rays)
        ray.origin += sign() * kWall_m * (test::kDivision + test::kRounding) * ray.direction;
    return moved;
}

/// Returns the gradient rows of the problem, and for each row the largest change that
/// random rounding errors cause.
std::pair<Rows, std::vector<double>> compute_expected_and_moved(const WallProblem& problem) {
    std::vector<Rows> draws(5);  // the first is the problem itself
    parallel_for(int(draws.size()), [&](int index) {
        WallProblem drawn = index == 0 ? problem : rounded(problem, std::uint64_t(index));
        draws[std::size_t(index)] = compute_expected_rows(drawn);
    });
    std::vector<double> moved(draws[0].size(), 0.0);
    for (const Rows& rows : draws)
        for (std::size_t k = 0; k < rows.size(); ++k) {
            std::vector<double> difference = rows[k].second;
            for (std::size_t j = 0; j < difference.size(); ++j) difference[j] -= draws[0][k].second[j];
            moved[k] = std::max(moved[k], test::GradientGroup::norm(difference));
        }
    return {draws[0], moved};
}

class LikelihoodGradient : public test::DeviceTest {
protected:
    /// Checks the error of each gradient row. The limit is 3 kKernelGradient plus twice
    /// the largest change that random rounding errors caused. Small rows are differences
    /// of large terms, so they change most.
    void expect_rows(const GradientTable& table, const Rows& expected, const std::vector<double>& moved,
                     const std::vector<std::vector<double>>& actual, const std::string& title) {
        for (std::size_t k = 0; k < actual.size(); ++k) {
            std::vector<double> difference = expected[k].second;
            for (std::size_t j = 0; j < difference.size(); ++j) difference[j] -= actual[k][j];
            const double small = test::kSmallRow * table.groups().at(expected[k].first).find_largest_row();
            const double scale = std::max(test::GradientGroup::norm(expected[k].second), small);
            EXPECT_LE(test::GradientGroup::norm(difference),
                      3.0 * test::kKernelGradient * scale + 2.0 * moved[k])
                << expected[k].first << ", row " << k << " of size " << scale << ", " << title;
        }
    }

    void expect_agreement(const LossWeights& weights, const std::string& title) {
        const WallProblem p(weights);
        const auto [expected, moved] = compute_expected_and_moved(p);
        for (const GradientReduction reduction : {GradientReduction::atomics, GradientReduction::gather})
            for (const std::uint32_t stored_hits_per_ray : {0u, 4u}) {
                DevicePasses passes(device(), p, stored_hits_per_ray, {.reduction = reduction});
                passes.run_all();
                const std::vector<double> terms = p.terms();
                const std::vector<float> device_result = passes.loss_terms.download();
                EXPECT_NEAR(std::accumulate(device_result.begin(), device_result.end(), 0.0),
                            std::accumulate(terms.begin(), terms.end(), 0.0), 1e-5);
                const std::vector<std::vector<double>> actual = collect_actual_rows(passes.gradients());
                ASSERT_EQ(actual.size(), expected.size());
                GradientTable table;
                for (std::size_t k = 0; k < actual.size(); ++k)
                    table.add_row(expected[k].first, expected[k].second, actual[k]);
                table.print(title);
                expect_rows(table, expected, moved, actual, title);
                for (const auto& [name, group] : table.groups()) {
                    EXPECT_EQ(group.count_missing_rows(), 0u) << name << ", " << title;
                    EXPECT_GT(group.count_nonzero_rows(), 0u) << name << ", " << title;
                }
            }
    }
};

LossWeights make_weights(float image, float likelihood) {
    LossWeights w;
    w.depth = w.intensity = w.drop = image;
    w.likelihood = likelihood;
    w.chamfer = 0.0f;
    w.likelihood_scale_m = 0.1f;
    w.likelihood_floor = 0.05f;
    w.normalised_depth = true;
    return w;
}

TEST_F(LikelihoodGradient, Alone) { expect_agreement(make_weights(0.0f, 1.0f), "likelihood"); }
TEST_F(LikelihoodGradient, WithTheImageLosses) { expect_agreement(make_weights(0.1f, 0.3f), "all terms"); }

/// Tests two surfels that are 30 cm apart, at 80 m and at 3 m. The measured range of the
/// ray is the range of the second surfel. In closed form the likelihood is S = w_0 k +
/// w_1 with k = 1 / (1 + (0.3 / s)^2).
TEST_F(LikelihoodGradient, TwoSurfelsInClosedForm) {
    for (const double start : {3.0, 79.0}) {
        const double t[] = {double(float(start)), double(float(start + 0.3))}, opacity[] = {0.6, 0.5};
        test::RandomScene scene;
        for (int i : {0, 1}) {
            reference::Surfel s;
            s.mean = {t[i], 0.0, 0.0};
            s.rotation = {0.70710678118654752, 0.0, 0.70710678118654752, 0.0};
            s.opacity_logit = std::log(opacity[i] / (1.0 - opacity[i]));
            scene.world.surfels.push_back(s);
        }
        scene.world.instances = {{0, 2, {}}};
        scene.rays = {{{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, t[1]}};
        std::vector<reference::PixelGradient> upstream(1);
        upstream[0].likelihood = 1.0;
        RendererOptions options = test::make_options({});
        options.trace.likelihood = RangeLikelihoodKernel{0.1f};
        test::Passes passes(device(), {}, scene, upstream, options);
        passes.run();
        const double scale = double(0.1f), d = (t[0] - t[1]) / scale, k = 1.0 / (1.0 + d * d), w0 = 0.6,
                     w1 = 0.4 * 0.5;
        const double slope = -2.0 * d / scale * k * k, resolved = 1.2e-7 * start;
        EXPECT_NEAR(passes.renderer.get_last_rendered_batch().rendered->download()[0].likelihood, w0 * k + w1,
                    1e-6 + w0 * slope * resolved);
        const Surfels device_result = passes.gradients().surfels.download();
        EXPECT_NEAR(device_result.mean[0].x, w0 * slope, 1e-6 + resolved * w0 / (scale * scale))
            << "the nearer one is drawn to the range";
        EXPECT_NEAR(device_result.mean[1].x, 0.0, 1e-6 + 2.0 * w1 * resolved / (scale * scale))
            << "the other is there";
        // S = s_0 k + (1 - s_0) s_1, where s_0 and s_1 are the opacities
        EXPECT_NEAR(device_result.opacity_logit[0], (k - 0.5) * 0.6 * 0.4, 1e-6 + slope * resolved);
        EXPECT_NEAR(device_result.opacity_logit[1], 0.4 * 0.5 * 0.5, 1e-6);
    }
}

TEST_F(LikelihoodGradient, GatheredTheSameBitsInEveryRun) {
    const WallProblem p(make_weights(0.1f, 0.3f));
    std::vector<float> first;
    for (int i = 0; i < 3; ++i) {
        DevicePasses passes(device(), p, 0, {.reduction = GradientReduction::gather});
        passes.run_all();
        std::vector<float> all;
        const DeviceGradients& g = passes.gradients();
        for (const Array<float>* array :
             std::initializer_list<const Array<float>*>{&g.records, &g.surfels.rotation, &g.rays, &g.poses})
            for (const float x : array->download()) all.push_back(x);
        if (i == 0) first = all;
        EXPECT_EQ(all, first);
    }
}

}  // namespace
}  // namespace relidar
