// SPDX-License-Identifier: Apache-2.0
// Checks the traversal contract on the device (diff/traversal/collect_hits): ray
// query over triangles and boxes, the software tree with a thread or a subgroup per ray,
// and brute force. Compares with brute force on the host. Both use the same float
// intersection, so the ordered ids must be equal. Differences within rounding (a hit on
// its outline, two almost equal t) are counted and limited.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>

#include <relidar/diff/accel.hpp>

#include "../../support/device.hpp"
#include "../../support/surfels.hpp"
#include "cases.hpp"
#include "diff/traversal/collect_hits.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/forced.hpp"
#include "gpu/stream.hpp"
#include "hit_comparison.hpp"

namespace relidar {
namespace {

using test::HitDifferences;
using test::TraversalCase;

constexpr std::uint32_t kMaxHits = 256;

using RayHits = std::vector<std::vector<reference::Hit>>;  // hits of each ray, from near to far

/// Converts hits of a scene from to_scene() to the surfel ids of the reference world.
RayHits to_reference(const std::vector<std::vector<shared::Hit>>& hits, const test::SceneAndPoses& placed) {
    RayHits result(hits.size());
    for (std::size_t ray = 0; ray < hits.size(); ++ray)
        for (const shared::Hit& hit : hits[ray])
            result[ray].push_back({hit.t, hit.instance, placed.original.at(hit.surfel)});
    return result;
}

/// Returns the hits of each ray that a test of all surfels on the host finds in float.
RayHits list_host_hits(const TraversalCase& test_case) {
    const reference::BruteForce brute(to_world(test_case), {}, reference::Precision::float_record);
    RayHits hits;
    for (const reference::Ray& ray : test::to_reference(test_case.rays)) hits.push_back(brute.list_hits(ray));
    return hits;
}

class HitsTest : public test::DeviceTest {
protected:
    HitDifferences compare(const TraversalCase& test_case, const RayHits& expected, const RayHits& actual) {
        const reference::World world = to_world(test_case);
        const std::vector<reference::Ray> rays = test::to_reference(test_case.rays);
        HitDifferences differences;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            EXPECT_LT(actual[i].size(), kMaxHits) << "the case may have more hits than the test keeps";
            compare_hits(world, {}, rays[i], i, expected[i], actual[i], differences);
        }
        return differences;
    }

    void expect_equal(const TraversalCase& test_case, const HitDifferences& differences,
                      const std::string& title) {
        EXPECT_EQ(differences.n_errors, 0u) << differences.summary(title) << "\n" << differences.first_error;
        const std::size_t allowed =
            test_case.grazing ? differences.n_rays / 100 : 2 + differences.n_rays / 5000;
        EXPECT_LE(differences.n_different_rays, allowed) << differences.summary(title);
    }
};

struct Setting {
    const char* name;
    AccelOptions accel;
    TraceOptions trace;
    bool brute_force = false;
    bool as_on_gpus = false;  ///< a subgroup shares its walk, but not its loads, as on GPUs
};

class DeviceHits : public HitsTest {
protected:
    RayHits collect(const TraversalCase& test_case, const Setting& setting) {
        const ForcedBehaviourScope forced(device(), {.brute_force = setting.brute_force});
        const test::SceneAndPoses placed = test::to_scene(test_case.surfels, test_case.instances);
        const ImageModel model{.primitive = test_case.surfels.primitive};
        Stream stream(device());
        DeviceScene scene(device(), placed.scene);
        scene.upload_poses(placed.world_from_instance);
        AccelerationStructure structure(device(), scene, setting.accel);
        scene.activate(stream, model, glm::vec3(0.0f));
        structure.record_refit(stream, scene);
        stream.submit_and_wait();
        std::vector<SpecialisationConstant> constants =
            trace_constants(device(), structure.proxy_shape(), setting.trace, model);
        for (SpecialisationConstant& c : constants)
            if (setting.as_on_gpus && c.id == SpecialisationConstantId::TOGETHER) c.value = 1u;
        return to_reference(
            collect_hits(device(), kernel_variant(device()), constants,
                         trace_params(scene, structure.addresses(), model), test_case.rays, kMaxHits),
            placed);
    }
    void expect_conformance(const std::vector<TraversalCase>& cases);
};

/// Returns the traversal settings that the test device supports. Brute force is the last
/// setting.
std::vector<Setting> providers(const Device& device, int chunk) {
    const Setting brute{"brute force", {}, {.chunk = chunk}, true};
    const TraceOptions subgroup{.chunk = chunk, .traversal_mode = BvhTraversalMode::subgroup};
    if (device.backend() == RayTracingBackend::software)
        return {{"lane", {}, {.chunk = chunk, .traversal_mode = BvhTraversalMode::lane}},
                {"subgroup", {}, subgroup},
                {"subgroup as on GPUs", {}, subgroup, false, true},
                brute};
    return {{"triangles", {.proxy = ProxyShape::triangles}, {.chunk = chunk}},
            {"boxes", {.proxy = ProxyShape::boxes}, {.chunk = chunk}},
            brute};
}

void DeviceHits::expect_conformance(const std::vector<TraversalCase>& cases) {
    for (const TraversalCase& c : cases) {
        const RayHits expected = list_host_hits(c);
        for (const int chunk : {1, 32})  // ChunkSize tests more sizes
            for (const Setting& s : providers(device(), chunk)) {
                const std::string title = c.name + ", " + s.name + ", chunk " + std::to_string(chunk);
                expect_equal(c, compare(c, expected, collect(c, s)), title);
            }
    }
}

TEST_F(DeviceHits, ConformanceCases) { expect_conformance(test::make_conformance_cases(11, 1000)); }
TEST_F(DeviceHits, ConformanceCasesOfGaussians) { expect_conformance(test::make_gaussian_cases(13, 500)); }

TEST_F(DeviceHits, CasesThatMove) { expect_conformance(test::make_moving_cases(17, 200)); }

class ChunkSize : public DeviceHits, public testing::WithParamInterface<PrimitiveType> {};
INSTANTIATE_TEST_SUITE_P(Primitives, ChunkSize,
                         testing::Values(PrimitiveType::surfel, PrimitiveType::gaussian));

TEST_P(ChunkSize, DoesNotMatter) {
    const TraversalCase c = GetParam() == PrimitiveType::gaussian ? test::make_crowded_case(6, 100, 500)
                                                                  : test::make_random_case(5, 400, 2000);
    const RayHits expected = collect(c, {"expected", {}, {.chunk = 64}});
    for (const int chunk : {1, 5, 32})
        for (const Setting& s : providers(device(), chunk)) {
            const RayHits actual = collect(c, s);
            for (std::size_t ray = 0; ray < c.rays.size(); ++ray)
                ASSERT_EQ(actual[ray], expected[ray]) << s.name << ", chunk " << chunk << ", ray " << ray;
        }
}

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

class ManyRays : public HitsTest, public testing::WithParamInterface<PrimitiveType> {
protected:
    TraversalCase case_ = test::make_random_case(20261120, 900, get_many_count());
    test::SceneAndPoses placed_;
    ImageModel model_;

    void SetUp() override {
        HitsTest::SetUp();
        if (GetParam() == PrimitiveType::gaussian)
            case_ = test::to_gaussians(test::make_random_case(20261123, 450, get_many_count()), 3);
        fill_with_invalid_values(case_.surfels);
        model_.primitive = GetParam();
        placed_ = test::to_scene(case_.surfels, case_.instances);
    }

    RayHits collect(const DeviceScene& scene, const AccelerationStructure& accel,
                    const TraceOptions& options) {
        return to_reference(collect_hits(device(), kernel_variant(device()),
                                         trace_constants(device(), accel.proxy_shape(), options, model_),
                                         trace_params(scene, accel.addresses(), model_), case_.rays, 64),
                            placed_);
    }

    void expect_agreement(const DeviceScene& scene, const AccelerationStructure& accel,
                          const std::string& state) {
        const RayHits brute = [&] {
            const ForcedBehaviourScope forced(device(), {.brute_force = true});
            return collect(scene, accel, {});
        }();
        for (const BvhTraversalMode traversal_mode : {BvhTraversalMode::lane, BvhTraversalMode::subgroup}) {
            if (traversal_mode == BvhTraversalMode::lane &&
                device().backend() == RayTracingBackend::ray_query)
                continue;
            const RayHits result = collect(scene, accel, {.traversal_mode = traversal_mode});
            std::size_t n_different = 0;
            for (std::size_t i = 0; i < case_.rays.size(); ++i) n_different += result[i] != brute[i];
            EXPECT_EQ(n_different, 0u)
                << state << (traversal_mode == BvhTraversalMode::lane ? ", lane" : ", subgroup")
                << ": rays whose hits differ from brute force";
        }
        const HitDifferences d = compare(case_, list_host_hits(case_), brute);
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
