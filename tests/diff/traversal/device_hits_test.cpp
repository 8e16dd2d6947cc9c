// SPDX-License-Identifier: Apache-2.0
// Checks the traversal contract on the device (diff/traversal/collect_hits): ray
// query over triangles and boxes, the software tree with a thread or a subgroup per ray,
// and brute force. Compares with brute force on the host.
#include "device_hits.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/forced.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

using test::HitDifferences;
using test::kMaxHits;
using test::list_hits;
using test::TraversalCase;

struct Setting {
    const char* name;
    AccelOptions accel;
    TraceOptions trace;
    bool brute_force = false;
    bool as_on_gpus = false;  ///< a subgroup shares its walk, but not its loads, as on GPUs
};

class DeviceHits : public test::DeviceHits {
protected:
    CollectedHits collect(const TraversalCase& test_case, const Setting& setting) {
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
        return test::convert_to_world(
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
        const std::vector<std::vector<reference::Hit>> expected = test::list_host_hits(c);
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
    const CollectedHits expected = collect(c, {"expected", {}, {.chunk = 64}});
    for (const int chunk : {1, 5, 32})
        for (const Setting& s : providers(device(), chunk)) {
            const CollectedHits actual = collect(c, s);
            EXPECT_EQ(actual.counts, expected.counts) << s.name << ", chunk " << chunk;
            for (std::size_t ray = 0; ray < c.rays.size(); ++ray)
                ASSERT_EQ(list_hits(actual, ray), list_hits(expected, ray))
                    << s.name << ", chunk " << chunk << ", ray " << ray;
        }
}

}  // namespace
}  // namespace relidar
