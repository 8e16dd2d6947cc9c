// SPDX-License-Identifier: Apache-2.0
// Tests the differentiable renderer through its host arrays: gradients against the double
// reference, growing batches, moving instances, and rejected inputs. tests/diff/backward
// tests all methods that find hits and sum gradients.
#include <relidar/base/error.hpp>
#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/first_use.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "../../support/surfels.hpp"
#include "../../support/work_in_flight.hpp"
#include "../backward/passes.hpp"
#include "gpu/buffer.hpp"
#include "gpu/check_device.hpp"
#include "gpu/trust.hpp"

namespace relidar {
namespace {

using test::lanes;

class Differentiable : public test::DeviceTest {
protected:
    reference::Settings settings;
    test::RandomScene scene =
        test::make_random_scene({.seed = 81, .actor_instances = 1, .rays = 40}, settings);
    test::SceneAndPoses placed = test::to_scene(scene.world);
    WorldRays rays = test::to_world_rays(scene.rays);

    void place(Renderer& renderer) {
        renderer.update(placed.world_from_instance, glm::vec3(scene.view_origin));
    }
};

RenderedGradients to_arrays(const std::vector<reference::PixelGradient>& d) {
    RenderedGradients result;
    for (const reference::PixelGradient& g : d) {
        result.depth.push_back(float(g.depth));
        result.weight.push_back(float(g.weight));
        result.intensity.push_back(float(g.intensity));
        result.hit_logit.push_back(float(g.hit_logit));
        result.drop_logit.push_back(float(g.drop_logit));
    }
    return result;
}

TEST_F(Differentiable, HostGradientsAgreeWithTheReference) {
    const std::vector<reference::PixelGradient> d_rendered = test::make_random_upstream(scene.rays.size(), 5);
    settings.view_origin = scene.view_origin;
    const reference::Gradients expected = reference::backward(scene.world, settings, scene.rays, d_rendered);
    DifferentiableRenderer differentiable(device(), placed.scene, settings.image, {},
                                          {.requested_gradients = {.rays = true, .poses = true}});
    Renderer& renderer = differentiable.renderer();
    place(renderer);
    // renders a small batch before a larger batch
    renderer.render_rays({{rays.origin[0]}, {rays.direction[0]}});
    EXPECT_EQ(renderer.render_rays(rays).size(), rays.size());
    const HostGradients device_result = differentiable.backpropagate(to_arrays(d_rendered));
    test::GradientTable table;
    for (std::size_t i = 0; i < expected.surfels.size(); ++i) {
        table.add_row("mean", lanes(expected.surfels[i].mean, 3), lanes(device_result.surfels.mean[i], 3));
        table.add_row("opacity_logit", {expected.surfels[i].opacity_logit},
                      {device_result.surfels.opacity_logit[i]});
        EXPECT_EQ(device_result.touched[i] != 0, glm::length(device_result.surfels.mean[i]) > 0.0f)
            << "surfel " << i;
    }
    ASSERT_EQ(device_result.rays.size(), 6 * rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i)
        table.add_row("ray direction", lanes(expected.rays[i].direction, 3),
                      lanes(&device_result.rays[6 * i + 3], 3));
    ASSERT_EQ(device_result.poses.size(), 12u);
    table.add_row("pose", lanes(expected.instances[1].translation, 3), lanes(&device_result.poses[6], 3));
    EXPECT_EQ(device_result.sensor.size(), 6u);
    for (const auto& [name, group] : table.groups()) {
        EXPECT_LE(group.compute_worst_error(), test::kKernelGradient) << name;
        EXPECT_EQ(group.count_missing_rows(), 0u) << name;
    }
}

TEST_F(Differentiable, EmptyLanesAreZeroAndOnlyRequestedValuesReturn) {
    std::vector<reference::PixelGradient> d_rendered = test::make_random_upstream(scene.rays.size(), 6);
    for (reference::PixelGradient& g : d_rendered) g = {.depth = g.depth};
    const GradientOptions bit_equal{.sums = {.reduction = GradientReduction::gather}};
    DifferentiableRenderer differentiable(device(), placed.scene, settings.image, {.keep_hits = 8},
                                          bit_equal);
    Renderer& renderer = differentiable.renderer();
    place(renderer);
    renderer.render_rays(rays);
    const HostGradients all = differentiable.backpropagate(to_arrays(d_rendered));
    const HostGradients depth_alone = differentiable.backpropagate({.depth = to_arrays(d_rendered).depth});
    EXPECT_EQ(depth_alone.surfels.mean, all.surfels.mean);
    EXPECT_EQ(depth_alone.surfels.sh, std::vector<float>(all.surfels.sh.size(), 0.0f));
    EXPECT_TRUE(all.poses.empty() && all.sensor.empty() && all.rays.empty());
}

/// Arrays that consist of several allocations must give the same bits. Here each page of
/// memory is a separate allocation.
TEST_F(Differentiable, ArraysOfSeveralAllocationsGiveTheSameBits) {
    Device::Impl& impl = device().impl();
    if (!impl.binds_sparse) GTEST_SKIP() << "no sparse binding";
    Surfels surfels = test::to_surfels(scene.world.surfels);
    for (int i = 0; i < 4; ++i) surfels.append_surfels(Surfels(surfels));
    const Scene many = wrap_background(surfels);
    const RenderedGradients d = to_arrays(test::make_random_upstream(scene.rays.size(), 7));
    const GradientOptions bit_equal{.sums = {.reduction = GradientReduction::gather}};
    std::vector<RenderedRayValues> images;
    std::vector<HostGradients> gradients;
    for (const std::uint64_t n_bytes : {impl.largest_allocation.n_bytes, std::uint64_t(1)}) {
        const std::uint64_t before = std::exchange(impl.largest_allocation.n_bytes, n_bytes);
        DifferentiableRenderer differentiable(device(), many, settings.image, {.keep_hits = 8}, bit_equal);
        differentiable.renderer().update(glm::vec3(scene.view_origin));
        images.push_back(differentiable.renderer().render_rays(rays));
        gradients.push_back(differentiable.backpropagate(d));
        const Array<float>& sh = differentiable.renderer().scene().surfel_parameters().sh;
        EXPECT_EQ(sh.buffer().impl().memory.size() > 1, n_bytes == 1);
        impl.largest_allocation.n_bytes = before;
    }
    EXPECT_EQ(images[0].depth, images[1].depth);
    EXPECT_EQ(images[0].intensity, images[1].intensity);
    EXPECT_EQ(images[0].drop_logit, images[1].drop_logit);
    EXPECT_EQ(gradients[0].surfels.mean, gradients[1].surfels.mean);
    EXPECT_EQ(gradients[0].surfels.sh, gradients[1].surfels.sh);
}

/// A renderer that is destroyed while the device renders must keep its arrays until the
/// device has finished.
TEST_F(Differentiable, ArraysOutliveSubmittedWork) {
    const Array<DeviceRay> device_rays(device(), to_device_rays(rays), "rays");
    const RayBatch batch{&device_rays, 0, 1, std::uint32_t(rays.size())};
    const test::WorkInFlight work;
    {
        DifferentiableRenderer differentiable(device(), placed.scene, settings.image,
                                              {.n_rays = batch.n_rays});
        place(differentiable.renderer());
        differentiable.renderer().record_forward(batch);
        differentiable.record_backward();
        differentiable.renderer().stream().submit_commands();
    }
    EXPECT_GT(work.n_destroyed(), 20);
    EXPECT_EQ(work.n_destroyed_in_flight(), 0);
}

/// If device memory is exhausted, the renderer must keep fewer hits instead of failing.
/// 32 hits of 16 bytes for 65536 rays need 32 MiB.
TEST_F(Differentiable, KeepsFewerHitsIfMemoryIsExhausted) {
    std::uint64_t& limit = device().impl().memory_limit_bytes;
    const std::uint64_t before = std::exchange(limit, device().allocated_bytes() + (48 << 20));
    Renderer renderer(device(), placed.scene, settings.image, {.n_rays = 65536, .keep_hits = 256});
    EXPECT_EQ(renderer.stored_hits_per_ray(), 32u);
    EXPECT_THROW(renderer.set_stored_hits(128), OutOfDeviceMemory);
    EXPECT_EQ(renderer.stored_hits_per_ray(), 32u) << "unchanged after the failure";
    place(renderer);
    EXPECT_EQ(renderer.render_rays(rays).size(), rays.size());
    limit = before;
}

TEST_F(Differentiable, MovedIsAsPlaced) {
    for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
        settings.image.sh_direction = direction;
        Renderer moved(device(), placed.scene, settings.image), anew(device(), placed.scene, settings.image);
        place(moved);
        std::vector<InstancePose> poses = moved.scene().poses();
        poses[1].world_from_model.translation.x += 0.3;
        moved.record_poses(poses, glm::vec3(0.1f, 0.0f, 0.2f));
        anew.update(poses, glm::vec3(0.1f, 0.0f, 0.2f));
        const RenderedRayValues a = moved.render_rays(rays), b = anew.render_rays(rays);
        EXPECT_EQ(a.depth, b.depth);
        EXPECT_EQ(a.intensity, b.intensity);
    }
}

TEST_F(Differentiable, WhatIsOutOfOrderIsRefused) {
    DifferentiableRenderer differentiable(device(), placed.scene, settings.image);
    Renderer& renderer = differentiable.renderer();
    EXPECT_THROW(renderer.render_rays(rays), UsageError) << "call place() first";
    EXPECT_THROW(differentiable.backpropagate({}), UsageError) << "not rendered";
    place(renderer);
    renderer.render_rays(rays);
    EXPECT_THROW(differentiable.backpropagate({.weight = std::vector<float>(3)}), DataError);
    EXPECT_THROW(renderer.upload_surfels(placed.scene.surfels.slice(0, 2)), DataError);
    EXPECT_THROW(renderer.update({InstancePose{}}, glm::vec3(0.0f)), DataError);
    differentiable.resize([](double bytes) { EXPECT_GT(bytes, 0.0); });
    EXPECT_THROW(renderer.render_rays(rays), UsageError) << "the structure is gone";
    place(renderer);
    EXPECT_EQ(renderer.render_rays(rays).size(), rays.size());
}

/// Tests the check of the device at the first use. The check must accept this device and
/// detect each forced fault.
class FirstUseTest : public test::DeviceTest {
protected:
    void SetUp() override {
        test::DeviceTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        options = apply_environment({.index = device().info().index, .traversal = device().backend()});
    }
    void TearDown() override {
        gpu::inject_faults("");
        set_open_callbacks({});
        test::DeviceTest::TearDown();
    }

    DeviceOptions options;
};

TEST_F(FirstUseTest, FindsWhatIsWrong) {
    const CheckVerdict unforced =
        device().backend() == RayTracingBackend::ray_query ? CheckVerdict::right : CheckVerdict::unknown;
    const DeviceTestResults right = test_device(options);
    EXPECT_TRUE(right.float_atomics && right.float_swaps);
    EXPECT_EQ(right.subgroup_size, 0);
    EXPECT_EQ(right.ray_query, unforced);
    gpu::inject_faults("float_atomics,float_swaps,ray_query");
    const DeviceTestResults wrong = test_device(options);
    EXPECT_EQ(wrong.float_atomics, !device().info().float_atomics);
    EXPECT_FALSE(wrong.float_swaps);
    EXPECT_EQ(wrong.ray_query, unforced == CheckVerdict::right ? CheckVerdict::wrong : CheckVerdict::unknown);
    if (unforced == CheckVerdict::right) {
        EXPECT_GT(count_wrong_rays(device()), 10);
    }
}

/// Simulates a fault of the current subgroup size. If the device supports several sizes,
/// the largest remaining size must be chosen.
TEST_F(FirstUseTest, ChoosesAnotherSubgroupSize) {
    if (!device().info().software) GTEST_SKIP() << "no subgroups of a known size";
    const std::vector<int> sizes = subgroup_sizes(device());
    const int size = device().info().subgroup_size;
    gpu::inject_faults("subgroups:" + std::to_string(size));
    if (sizes.size() == 1) {
        EXPECT_THROW(test_device(options), DeviceError);
        return;
    }
    const int other = sizes.back() == size ? sizes[sizes.size() - 2] : sizes.back();
    EXPECT_EQ(test_device(options).subgroup_size, other);
}

TEST_F(FirstUseTest, WrongAtomicsLeadToGatheredGradients) {
    std::vector<std::string> notes;
    set_open_callbacks({test_device, [&](const std::string& text) { notes.push_back(text); }});
    gpu::inject_faults("float_atomics");
    Device opened(options);
    const ImageModel model{.sh_direction = ShDirection::surfel};
    Surfels surfels;
    surfels.resize(1);
    DifferentiableRenderer differentiable(opened, wrap_background(surfels), model);
    EXPECT_NE(differentiable.backward_pass().max_hit_count(), nullptr);
    EXPECT_EQ(notes.size(), device().info().float_atomics ? 1u : 0u);
}

}  // namespace
}  // namespace relidar
