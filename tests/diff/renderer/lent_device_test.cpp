// SPDX-License-Identifier: Apache-2.0
// Renders on a Vulkan device that the test has opened and lends to relidar.
#include <memory>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>

#include "../../support/device.hpp"
#include "../../support/random_scene.hpp"
#include "../../support/surfels.hpp"
#include "gpu/vulkan.hpp"

namespace relidar {
namespace {

using testing::HasSubstr;

/// A simulator that opens the device of the tests with the features that relidar needs.
struct Simulator {
    VkInstance instance = VK_NULL_HANDLE;
    VkDevice device = VK_NULL_HANDLE;
    LentVulkan lent;

    explicit Simulator(const DeviceInfo& info) {
        EXPECT_EQ(volkInitialize(), VK_SUCCESS);
        const VkApplicationInfo app{.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO,
                                    .apiVersion = VK_API_VERSION_1_3};
        const VkInstanceCreateInfo create{.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
                                          .pApplicationInfo = &app};
        EXPECT_EQ(vkCreateInstance(&create, nullptr, &instance), VK_SUCCESS);
        volkLoadInstance(instance);
        std::uint32_t n = 0;
        vkEnumeratePhysicalDevices(instance, &n, nullptr);
        std::vector<VkPhysicalDevice> all(n);
        vkEnumeratePhysicalDevices(instance, &n, all.data());
        open(all.at(std::size_t(info.index)), info.ray_query);
    }
    ~Simulator() {
        vkDestroyDevice(device, nullptr);
        vkDestroyInstance(instance, nullptr);
    }

private:
    void open(VkPhysicalDevice physical, bool has_ray_query) {
        const float priority = 1.0f;
        const VkDeviceQueueCreateInfo queues{.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
                                             .queueCount = 1,
                                             .pQueuePriorities = &priority};
        VkPhysicalDeviceRayQueryFeaturesKHR query{
            .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_RAY_QUERY_FEATURES_KHR, .rayQuery = VK_TRUE};
        VkPhysicalDeviceAccelerationStructureFeaturesKHR accel{
            .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ACCELERATION_STRUCTURE_FEATURES_KHR,
            .pNext = &query,
            .accelerationStructure = VK_TRUE};
        VkPhysicalDeviceVulkan13Features v13{.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES,
                                             .pNext = has_ray_query ? &accel : nullptr};
        v13.maintenance4 = v13.computeFullSubgroups = v13.subgroupSizeControl = VK_TRUE;
        VkPhysicalDeviceVulkan12Features v12{.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES,
                                             .pNext = &v13};
        v12.bufferDeviceAddress = v12.scalarBlockLayout = v12.timelineSemaphore = v12.hostQueryReset =
            VK_TRUE;
        lent.features = {"maintenance4",        "computeFullSubgroups", "subgroupSizeControl",
                         "bufferDeviceAddress", "scalarBlockLayout",    "timelineSemaphore",
                         "hostQueryReset"};
        std::vector<const char*> names;
        if (has_ray_query) {
            names = {"VK_KHR_deferred_host_operations", "VK_KHR_ray_query", "VK_KHR_acceleration_structure"};
            lent.extensions = {names.begin(), names.end()};
            lent.features.insert(lent.features.end(), {"rayQuery", "accelerationStructure"});
        }
        const VkDeviceCreateInfo create{.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
                                        .pNext = &v12,
                                        .queueCreateInfoCount = 1,
                                        .pQueueCreateInfos = &queues,
                                        .enabledExtensionCount = std::uint32_t(names.size()),
                                        .ppEnabledExtensionNames = names.data()};
        EXPECT_EQ(vkCreateDevice(physical, &create, nullptr, &device), VK_SUCCESS);
        VkQueue queue = VK_NULL_HANDLE;
        vkGetDeviceQueue(device, 0, 0, &queue);
        lent.instance = instance;
        lent.physical_device = physical;
        lent.device = device;
        lent.queue = queue;
    }
};

class LentDevice : public test::DeviceTest {
protected:
    reference::Settings settings;
    test::RandomScene scene = test::make_random_scene({.seed = 5, .rays = 200}, settings);

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
    const DeviceOptions options =
        apply_environment({.index = device().info().index, .traversal = device().backend()});
    const std::vector<float> expected = render(device());
    ASSERT_GT(*std::ranges::max_element(expected), 0.1f);
    for (const bool is_lent_first : {true, false}) {
        Simulator simulator(device().info());
        auto own = std::make_unique<Device>(options);
        std::unique_ptr<Device> lent(new Device(Device::from_vulkan(simulator.lent, options)));
        EXPECT_EQ(lent->backend(), own->backend());
        EXPECT_EQ(render(*lent), expected);
        EXPECT_EQ(render(*own), expected);
        (is_lent_first ? lent : own).reset();
        EXPECT_EQ(render(lent ? *lent : *own), expected);
        lent.reset();
        EXPECT_EQ(vkDeviceWaitIdle(simulator.device), VK_SUCCESS);
    }
}

TEST_F(LentDevice, WhatItsOwnerHasNotEnabledIsListed) {
    Simulator simulator(device().info());
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
