// SPDX-License-Identifier: Apache-2.0
// Checks the gradients of instance poses and of the sensor's pose
// (diff/backward/pose_blocks, poses and sensor_pose).
#include <glm/gtc/quaternion.hpp>

#include <random>

#include "../../support/floats.hpp"
#include "diff/backward/pose_gradients.hpp"
#include "passes.hpp"
#include "scene/benchmark_street.hpp"

namespace relidar {
namespace {

using test::GradientProblem;
using test::GradientTable;
using test::lanes;
using test::Passes;

/// Returns the loss terms after the sensor is translated by `vector` and rotated by w
/// about the view origin.
std::vector<double> terms_of_moved_sensor(test::GradientProblem p, const glm::dvec3& vector,
                                          const glm::dvec3& w) {
    const glm::dquat rotation = test::make_rotation_by(w);
    const glm::dvec3 origin = std::exchange(p.settings.view_origin, p.settings.view_origin + vector);
    for (reference::Ray& ray : p.scene.rays)
        ray = {origin + rotation * (ray.origin - origin) + vector, rotation * ray.direction, ray.measured_m,
               ray.time_s};
    return p.terms();
}

/// Computes central differences of `terms` with respect to a twist (v, w).
std::vector<double> compute_twist_differences(
    const std::function<std::vector<double>(const glm::dvec3&, const glm::dvec3&)>& terms) {
    glm::dvec3 v(0.0), w(0.0);
    const auto now = [&] { return terms(v, w); };
    std::vector<double> result = test::compute_central_differences(&v.x, 3, now);
    for (const double x : test::compute_central_differences(&w.x, 3, now, test::kAngleStep))
        result.push_back(x);
    return result;
}

void add_twist(GradientTable& table, const std::string& name, const std::vector<double>& expected,
               const std::vector<double>& actual) {
    const auto half = [](const std::vector<double>& row, int index) {
        return std::vector<double>(row.begin() + 3 * index, row.begin() + 3 * index + 3);
    };
    table.add_row(name + " translation", half(expected, 0), half(actual, 0));
    table.add_row(name + " rotation", half(expected, 1), half(actual, 1));
}

class PoseGradient : public test::DeviceTest {
protected:
    void expect_agreement(ShDirection direction, const test::RandomSceneOptions& options,
                          const std::string& title, test::Outputs outputs = test::Outputs::image) {
        GradientProblem p({.sh_direction = direction}, options, outputs);
        const reference::Gradients expected = p.gradients();
        RendererOptions renderer = test::make_options(p.settings.image);
        if (outputs != test::Outputs::image) renderer.trace.likelihood = RangeLikelihoodKernel{0.3f};
        Passes passes(device(), p, renderer);
        passes.run();
        const std::vector<float> poses = passes.gradients().poses.download();
        GradientTable table;
        for (std::size_t k = 0; k < expected.instances.size(); ++k) {
            std::vector<double> row = lanes(expected.instances[k].translation, 3);
            for (const double x : lanes(expected.instances[k].rotation, 3)) row.push_back(x);
            add_twist(table, "reference pose", row, lanes(poses.data() + 6 * k, 6));
            reference::Placement& placed = p.scene.world.instances[k];
            const Pose start = placed.world_from_model;
            const std::vector<double> differences = compute_twist_differences([&](const glm::dvec3& vector,
                                                                                  const glm::dvec3& w) {
                const Pose changed{test::make_rotation_by(w) * start.rotation, start.translation + vector};
                if (options.moving) placed.change = inverse(start) * changed;
                else placed.world_from_model = changed;
                return p.terms();
            });
            placed.world_from_model = start;
            placed.change = {};
            add_twist(table, "differences, pose", differences, lanes(poses.data() + 6 * k, 6));
        }
        // If instances move during the sweep, the sensor's gradient
        // (DeviceGradients::sensor) is only an approximation, so it is not compared.
        if (!options.moving)
            add_twist(table, "differences, sensor",
                      compute_twist_differences([&](const glm::dvec3& vector, const glm::dvec3& w) {
                          return terms_of_moved_sensor(p, vector, w);
                      }),
                      lanes(passes.gradients().sensor.download().data(), 6));
        table.print(title);
        for (const auto& [name, group] : table.groups()) {
            EXPECT_LE(group.compute_worst_error(), test::kKernelGradient) << name << ", " << title;
            EXPECT_EQ(group.count_nonzero_rows(), group.actual.size()) << name << ", " << title;
        }
    }
};

TEST_F(PoseGradient, ModelPlacedThriceShAlongRay) {
    expect_agreement(ShDirection::ray, {.seed = 41, .actor_instances = 3, .rays = 60},
                     "poses, SH along the ray, one model placed three times");
}

TEST_F(PoseGradient, OfModelsThatMoveWhileRaysAreFired) {
    expect_agreement(ShDirection::ray, {.seed = 47, .actor_instances = 3, .rays = 60, .moving = true},
                     "poses, models that drive and turn");
}

TEST_F(PoseGradient, OfTheSensorIsExactInTranslationWhereModelsOnlyDrive) {
    const test::RandomSceneOptions options{
        .seed = 48, .actor_instances = 3, .rays = 60, .moving = true, .angular_speed_radps = 0.0};
    GradientProblem p({.sh_direction = ShDirection::ray}, options);
    Passes passes(device(), p, test::make_options(p.settings.image));
    passes.run();
    glm::dvec3 v(0.0);
    const std::vector<double> expected = test::compute_central_differences(
        &v.x, 3, [&] { return terms_of_moved_sensor(p, v, glm::dvec3(0.0)); });
    GradientTable table;
    table.add_row("sensor translation", expected, lanes(passes.gradients().sensor.download().data(), 3));
    table.print("sensor, models that drive");
    EXPECT_LE(table.groups().at("sensor translation").compute_worst_error(), test::kKernelGradient);
}

TEST_F(PoseGradient, GaussiansPlacedTwice) {
    expect_agreement(ShDirection::ray, {.seed = 46, .rays = 60, .primitive = PrimitiveType::gaussian},
                     "poses, 3D Gaussians, one model placed twice");
}

TEST_F(PoseGradient, ShAlongSurfelSeesTheViewOriginMove) {
    expect_agreement(ShDirection::surfel, {.seed = 42, .actor_surfels = 30, .actor_instances = 1, .rays = 60},
                     "poses, SH along sensor -> mean, an actor in the background");
}

TEST_F(PoseGradient, WithTheLikelihood) {
    expect_agreement(ShDirection::ray, {.seed = 49, .rays = 60}, "poses, image and likelihood",
                     test::Outputs::all);
}

Scene make_background_and_actor(std::uint32_t n_background, std::uint32_t n_actor) {
    Scene layout = wrap_background(make_street_surfels(n_background + n_actor));
    layout.models = {{"background", 0, n_background}, {"actor", n_background, n_actor}};
    layout.instances.push_back({1, "actor"});
    return layout;
}

/// Tests a street and an actor with so many surfels that each is summed in several
/// blocks. The gradients of the hits are random. Compares with sums in double and checks
/// that all runs give the same bits.
TEST_F(PoseGradient, ManyBlocksOfSurfels) {
    const Scene layout = make_background_and_actor(2500, 1100);
    const std::size_t n = layout.surfels.size();
    const glm::dvec3 view_origin(1.0, -2.0, 0.5);
    const Pose pose{glm::angleAxis(0.7, glm::normalize(glm::dvec3(1.0, 2.0, 3.0))), {4.0, -1.0, 0.3}};
    std::mt19937_64 random(45);
    std::normal_distribution<float> normal;
    std::vector<float> d_records(16 * n), d_view(3 * n);
    for (std::size_t i = 0; i < n; i += 2) {  // the other surfels have no gradient
        for (std::size_t k = 0; k < 16; ++k) d_records[16 * i + k] = normal(random);
        for (std::size_t k = 0; k < 3; ++k) d_view[3 * i + k] = normal(random);
    }
    for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
        ImageModel model;
        model.sh_direction = direction;
        DeviceScene scene(device(), layout);
        scene.upload_poses({Pose{}, pose});
        Stream stream(device());
        scene.activate(stream, model, glm::vec3(view_origin));
        stream.submit_and_wait();
        DeviceGradients gradients(device(), scene, {.poses = true});
        gradients.records.upload(d_records);
        gradients.pose_sums->d_view.upload(d_view);
        PoseGradientKernels kernels(device());
        kernels.reduce(stream, scene, model, glm::vec3(view_origin), gradients);
        stream.submit_and_wait();
        const std::vector<float> poses = gradients.poses.download(),
                                 records = test::to_floats(scene.surfel_records().download());
        const auto three = [](const std::vector<float>& v, std::size_t index) {
            return glm::dvec3(v[index], v[index + 1], v[index + 2]);
        };
        GradientTable table;
        for (std::size_t k = 0; k < 2; ++k) {
            glm::dvec3 force(0.0), torque(0.0), view(0.0);
            for (std::size_t i = layout.models[k].first; i < layout.models[k].first + layout.models[k].count;
                 ++i) {
                force += three(d_records, 16 * i);
                for (const std::size_t lane : {0, 4, 8, 12})
                    torque += glm::cross(three(records, 16 * i + lane), three(d_records, 16 * i + lane));
                if (direction == ShDirection::surfel) view += three(d_view, 3 * i);
                else
                    torque -=
                        glm::dvec3(d_records[16 * i + 7], d_records[16 * i + 11], d_records[16 * i + 15]);
            }
            const Pose placed = k == 1 ? pose : Pose{};
            torque -= glm::cross(inverse(placed) * view_origin, view);
            std::vector<double> expected = lanes(placed.rotation * (force - view), 3);
            for (const double x : lanes(placed.rotation * torque, 3)) expected.push_back(x);
            add_twist(table, "sums in double", expected, lanes(poses.data() + 6 * k, 6));
        }
        table.print("poses, blocks of surfels");
        for (const auto& [name, group] : table.groups())
            EXPECT_LE(group.compute_worst_error(), test::kKernelGradient) << name;
        for (int again = 0; again < 5; ++again) {
            kernels.reduce(stream, scene, model, glm::vec3(view_origin), gradients);
            stream.submit_and_wait();
            EXPECT_EQ(gradients.poses.download(), poses);
        }
    }
}

/// Instances that are behind the sensor, absent, or hit only by rays without a gradient
/// must have a gradient of exactly zero.
TEST_F(PoseGradient, WhatNoRayMeetsHasNone) {
    const test::RandomSceneOptions options{.seed = 44, .actor_instances = 3};
    GradientProblem p({.sh_direction = ShDirection::ray}, options);
    Passes passes(device(), p, test::make_options(p.settings.image));
    std::vector<InstancePose> placed = passes.renderer.scene().poses();
    placed[1].world_from_model.translation = {-20.0, 0.0, 0.0};
    placed[2].present = false;
    passes.renderer.scene().stage_poses(passes.renderer.stream(), placed);
    passes.run();
    const std::vector<float> poses = passes.gradients().poses.download();
    double met = 0.0;
    for (std::size_t k = 0; k < 6; ++k) {
        EXPECT_EQ(poses[6 + k], 0.0f) << "behind the sensor";
        EXPECT_EQ(poses[12 + k], 0.0f) << "absent";
        met += std::abs(poses[18 + k]);
    }
    EXPECT_GT(met, 0.0);
    passes.renderer.stream().fill(*passes.differentiable.last_batch().upstream);
    passes.run();
    for (const float x : passes.gradients().poses.download()) EXPECT_EQ(x, 0.0f);
    for (const float x : passes.gradients().sensor.download()) EXPECT_EQ(x, 0.0f);
}

}  // namespace
}  // namespace relidar
