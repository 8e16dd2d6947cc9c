// SPDX-License-Identifier: Apache-2.0
// Tests the tree traversal of software_bvh.glsl on trees that are built on the host. The
// test does not depend on the device's tree builder.
#include "../../support/host_bvh.hpp"
#include "device_hits.hpp"
#include "diff/traversal/collect_hits.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

using test::TraversalCase;

class SoftwareWalk : public test::DeviceHits {
protected:
    CollectedHits collect(const TraversalCase& test_case, std::uint32_t chunk, std::uint32_t packet) {
        const test::SceneAndPoses placed = test::to_scene(test_case.surfels, test_case.instances);
        Stream stream(device());
        DeviceScene scene(device(), placed.scene);
        scene.upload_instance_poses_and_wait(placed.world_from_instance);
        const ImageFormationModel model{.primitive = test_case.surfels.primitive};
        scene.record_activation_of_surfel_parameters(stream, model, glm::vec3(0.0f));
        stream.submit_and_wait();
        const test::HostBvh bvh(device(), scene);
        const shared::TraceScene trace =
            make_trace_scene_params(scene, {.tlas = {}, .proxy_reach = {}, .bvh = bvh.pointers()}, model);
        const auto primitive = static_cast<std::uint32_t>(test_case.surfels.primitive);
        const std::vector<SpecialisationConstant> constants{{SpecialisationConstantId::CHUNK, chunk},
                                                            {SpecialisationConstantId::TOGETHER, packet},
                                                            {SpecialisationConstantId::PRIMITIVE, primitive}};
        return test::convert_to_world(collect_ray_hits(device(), KernelVariant("@software_bvh"), constants,
                                                       trace, test_case.rays, test::kMaxHits),
                                      placed);
    }
};

TEST_F(SoftwareWalk, ConformanceCases) {
    if (device().get_ray_tracing_backend() != RayTracingBackend::software)
        GTEST_SKIP() << "the software traversal's own";
    std::vector<TraversalCase> cases = test::make_conformance_cases(21, 1000);
    cases.push_back(test::make_crowded_case(22, 120, 500));
    for (const TraversalCase& c : cases) {
        const reference::BruteForce brute(test::to_world(c), {}, reference::Precision::float_record);
        for (const std::uint32_t chunk : {1u, 64u})
            for (std::uint32_t packet = 0; packet <= (device().info().type == "CPU" ? 2u : 1u); ++packet)
                expect_equal(c, compare(c, brute, collect(c, chunk, packet)),
                             c.name + (packet ? ", subgroup" : ", lane") +
                                 (packet == 2 ? ", sharing loads" : "") + ", chunk " + std::to_string(chunk));
    }
}

}  // namespace
}  // namespace relidar
