// SPDX-License-Identifier: Apache-2.0
// Renders on a Vulkan device that is lent to relidar.
#include <memory>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>

#include "../../support/device.hpp"
#include "../../support/random_scene.hpp"
#include "../../support/surfels.hpp"
#include "gpu/context.hpp"

namespace relidar {
namespace {

using testing::HasSubstr;

/// A program that lends its device. Here, relidar itself has opened the device.
struct Simulator {
    Device own;
    LentVulkan lent;

    explicit Simulator(const DeviceOptions& options) : own(options) {
        const Device::Impl& impl = own.impl();
        lent.instance = impl.instance->handle;
        lent.physical_device = impl.physical;
        lent.device = impl.device;
        lent.queue = impl.queue;
        lent.queue_family = impl.queue_family;
        lent.extensions = {impl.extensions.begin(), impl.extensions.end()};
        lent.features = {"maintenance4",        "computeFullSubgroups", "subgroupSizeControl",
                         "bufferDeviceAddress", "scalarBlockLayout",    "timelineSemaphore",
                         "hostQueryReset"};
        if (impl.traversal == RayTracingBackend::ray_query)
            lent.features.insert(lent.features.end(), {"rayQuery", "accelerationStructure"});
    }
};

class LentDevice : public test::DeviceTest {
protected:
    reference::Settings settings;
    test::RandomScene scene = test::make_random_scene({.seed = 5, .rays = 200}, settings);

    DeviceOptions options() {
        return apply_environment({.index = device().info().index, .traversal = device().backend()});
    }
    std::vector<float> render(Device& on) const {
        const test::SceneAndPoses placed = test::to_scene(scene.world);
        Renderer renderer(on, placed.scene, {});
        renderer.update(placed.world_from_instance, glm::vec3(scene.view_origin));
        RenderedRayValues rays = renderer.render_rays(test::to_world_rays(scene.rays));
        rays.depth.insert(rays.depth.end(), rays.intensity.begin(), rays.intensity.end());
        return rays.depth;
    }
};

TEST_F(LentDevice, RendersAsAnOwnDeviceAndIsNotDestroyed) {
    const std::vector<float> expected = render(device());
    ASSERT_GT(*std::ranges::max_element(expected), 0.1f);
    for (const bool is_lent_first : {true, false}) {
        Simulator simulator(options());
        auto own = std::make_unique<Device>(options());
        std::unique_ptr<Device> lent(new Device(Device::from_vulkan(simulator.lent, options())));
        EXPECT_EQ(lent->backend(), own->backend());
        EXPECT_EQ(render(*lent), expected);
        EXPECT_EQ(render(*own), expected);
        (is_lent_first ? lent : own).reset();
        EXPECT_EQ(render(lent ? *lent : *own), expected);
        lent.reset();
        EXPECT_EQ(vkDeviceWaitIdle(simulator.own.impl().device), VK_SUCCESS);
    }
}

TEST_F(LentDevice, WhatItsOwnerHasNotEnabledIsListed) {
    Simulator simulator(options());
    const auto message = [](const LentVulkan& lent, RayTracingBackend traversal) {
        try {
            Device::from_vulkan(lent, {.traversal = traversal});
        } catch (const DeviceError& error) {
            return std::string(error.what());
        }
        return std::string();
    };
    LentVulkan lent = simulator.lent;
    std::erase(lent.features, "scalarBlockLayout");
    std::erase(lent.features, "maintenance4");
    const std::string missing = message(lent, device().backend());
    EXPECT_THAT(missing, testing::AllOf(HasSubstr("scalarBlockLayout"), HasSubstr("maintenance4")));
    EXPECT_THAT(missing, testing::Not(HasSubstr("timelineSemaphore")));
    lent = simulator.lent;
    lent.extensions.clear();
    EXPECT_THAT(message(lent, RayTracingBackend::ray_query), HasSubstr("VK_KHR_ray_query"));
    lent.queue = nullptr;
    EXPECT_THAT(message(lent, device().backend()), HasSubstr("queue"));
}

}  // namespace
}  // namespace relidar
