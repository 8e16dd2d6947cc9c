// SPDX-License-Identifier: Apache-2.0
// Traces many random rays through instances, surfels at equal distance, and surfels that
// must never be hit.
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>

#include <relidar/diff/accel.hpp>
#include "device_hits.hpp"
#include "diff/traversal/collect_hits.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/forced.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

using test::TraversalCase;

int get_many_count() {
    const char* text = std::getenv("RELIDAR_MANY_RAYS");
    return text ? std::atoi(text) : 10000;
}

/// Makes every fortieth surfel invalid, each in a different way.
void fill_with_invalid_values(Surfels& surfels) {
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN(),
                    kInf = std::numeric_limits<float>::infinity();
    for (std::size_t i = 0; i < surfels.size(); i += 40) {
        const std::size_t kind = i / 40 % 6;
        if (kind == 0) surfels.mean[i].y = kNan;
        else if (kind == 1) surfels.mean[i].x = -kInf;
        else if (kind == 2) surfels.rotation[i] = glm::vec4(0.0f);
        else if (kind == 3) surfels.log_scale[i].x = -kInf;
        else surfels.opacity_logit[i] = kind == 4 ? kNan : -1e4f;
    }
}

/// Changes surfels like large steps of an optimiser.
void move_randomly(Surfels& surfels, std::mt19937& random) {
    std::normal_distribution<float> normal;
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        surfels.mean[i] += 0.3f * glm::vec3(normal(random), normal(random), normal(random));
        surfels.rotation[i] +=
            0.2f * glm::vec4(normal(random), normal(random), normal(random), normal(random));
        surfels.log_scale[i] += 0.2f * glm::vec2(normal(random), normal(random));
        if (surfels.primitive == PrimitiveType::gaussian) surfels.log_scale_w[i] += 0.2f * normal(random);
    }
}

class ManyRays : public test::DeviceHits, public testing::WithParamInterface<PrimitiveType> {
protected:
    TraversalCase case_ = test::make_random_case(20261120, 900, get_many_count());
    test::SceneAndPoses placed_;
    ImageModel model_;

    void SetUp() override {
        DeviceHits::SetUp();
        if (GetParam() == PrimitiveType::gaussian)
            case_ = test::to_gaussians(test::make_random_case(20261123, 450, get_many_count()), 3);
        fill_with_invalid_values(case_.surfels);
        model_.primitive = GetParam();
        placed_ = test::to_scene(case_.surfels, case_.instances);
    }

    CollectedHits collect(const DeviceScene& scene, const AccelerationStructure& accel,
                          const TraceOptions& options) {
        return collect_hits(device(), kernel_variant(device()),
                            trace_constants(device(), accel.proxy_shape(), options, model_),
                            trace_params(scene, accel.addresses(), model_), case_.rays, 64);
    }

    void expect_agreement(const DeviceScene& scene, const AccelerationStructure& accel,
                          const std::string& state) {
        const CollectedHits brute = [&] {
            const ForcedBehaviourScope forced(device(), {.brute_force = true});
            return collect(scene, accel, {});
        }();
        for (const BvhTraversalMode traversal_mode : {BvhTraversalMode::lane, BvhTraversalMode::subgroup}) {
            if (traversal_mode == BvhTraversalMode::lane &&
                device().backend() == RayTracingBackend::ray_query)
                continue;
            const CollectedHits result = collect(scene, accel, {.traversal_mode = traversal_mode});
            std::size_t n_different = 0;
            for (std::size_t i = 0; i < case_.rays.size(); ++i)
                n_different += test::list_hits(result, i) != test::list_hits(brute, i);
            EXPECT_EQ(n_different, 0u)
                << state << (traversal_mode == BvhTraversalMode::lane ? ", lane" : ", subgroup")
                << ": rays whose hits differ from brute force";
        }
        const test::HitDifferences d = compare(case_, test::list_host_hits(case_), brute);
        std::printf("%s\n", d.summary(state + ", against the host").c_str());
        expect_equal(case_, d, state);
    }
};

INSTANTIATE_TEST_SUITE_P(Primitives, ManyRays,
                         testing::Values(PrimitiveType::surfel, PrimitiveType::gaussian));

TEST_P(ManyRays, AgreeAfterBuildRefitAndRebuild) {
    Stream stream(device());
    DeviceScene scene(device(), placed_.scene);
    scene.upload_poses(placed_.world_from_instance);
    AccelerationStructure accel(device(), scene, {});
    std::mt19937 random(5);
    const auto update = [&](bool rebuild) {
        // The surfel ranges of this case are consecutive, so a surfel has the same index
        // in the case and in the scene.
        scene.surfel_parameters().upload(case_.surfels);
        scene.activate(stream, model_, glm::vec3(0.0f));
        accel.record_refit(stream, scene, rebuild);
        stream.submit_and_wait();
    };
    update(false);
    expect_agreement(scene, accel, "built");
    move_randomly(case_.surfels, random);
    update(false);
    ASSERT_EQ(accel.n_refits(), 1);
    expect_agreement(scene, accel, "refitted");
    move_randomly(case_.surfels, random);
    update(true);
    ASSERT_EQ(accel.n_refits(), 0);
    expect_agreement(scene, accel, "rebuilt");
}

}  // namespace
}  // namespace relidar
