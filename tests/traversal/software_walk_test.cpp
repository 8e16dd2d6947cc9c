// SPDX-License-Identifier: Apache-2.0
// The walk of software_bvh.glsl alone, over trees built on the host: what fails here is the traversal, not the device's builder.
#include "../support/host_bvh.hpp"
#include "device_hits.hpp"
#include "gpu/stream.hpp"
#include "traversal/trace_scene.hpp"

namespace relidar {
namespace {

using test::TraversalCase;

class SoftwareWalk : public test::DeviceHits {
protected:
    CollectedHits collect(const TraversalCase& c, std::uint32_t chunk, std::uint32_t packet) {
        const test::SceneAndPoses placed = test::to_scene(c.surfels, c.instances);
        Stream stream(device());
        DeviceScene scene(device(), placed.scene);
        scene.set_poses(placed.world_from_instance);
        const ImageModel model;
        scene.activate(stream, model, glm::vec3(0.0f));
        stream.finish();
        const test::HostBvh bvh(device(), scene);
        const Kernel<shared::CollectHitsParams> kernel(device(), "traversal/collect_hits@software_bvh", {{1u, chunk}, {4u, packet}});
        const std::size_t n = c.rays.size(), n_slots = n * test::kMaxHits;
        const Array<DeviceRay> rays(device(), std::span<const DeviceRay>(to_device_rays(c.rays)), "rays");
        const Array<std::uint32_t> pass_cap(device(), std::vector<std::uint32_t>{0u}, "pass cap count");
        const Array<std::uint32_t> counts(device(), n, "counts"), instance(device(), n_slots, "instances"), surfel(device(), n_slots, "surfels");
        const Array<float> t(device(), n_slots, "distances");
        const shared::TraceScene trace{0, bvh.pointers(), rays.address(), scene.records().address(), scene.instances_address(), scene.parameters().sh.address(), pass_cap.address(), 0,
                                       model.near_m, model.alpha_min, model.alpha_max, model.transmittance_min, static_cast<std::uint32_t>(placed.scene.instances.size()),
                                       static_cast<std::uint32_t>(model.sh_degree), static_cast<std::uint32_t>(n), 0, 1};
        run(stream, kernel, n, {trace, counts.address(), t.address(), instance.address(), surfel.address(), test::kMaxHits});
        stream.finish();
        EXPECT_EQ(pass_cap.download()[0], 0u);
        return {test::kMaxHits, counts.download(), t.download(), instance.download(), surfel.download()};
    }
};

TEST_F(SoftwareWalk, ConformanceCases) {
    for (const TraversalCase& c : test::conformance_cases(21, 2000)) {
        const reference::BruteForce brute(test::to_world(c), {}, reference::Precision::float_record);
        for (const std::uint32_t chunk : {1u, 5u, 16u, 64u})
            for (const std::uint32_t packet : {0u, 1u})
                expect_equal(c, compare(c, brute, collect(c, chunk, packet)), c.name + (packet ? ", subgroup" : ", lane") + ", chunk " + std::to_string(chunk));
    }
}

}  // namespace
}  // namespace relidar
