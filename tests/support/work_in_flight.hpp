// SPDX-License-Identifier: Apache-2.0
// Counts the buffers that are destroyed while the device may still use them. Replaces the
// Vulkan functions that submit, wait and destroy.
#pragma once

#include <utility>

#include "gpu/vulkan.hpp"

namespace relidar::test {

/// Watches the device while it exists. Only one object may exist at a time, and only one
/// thread may use the device.
class WorkInFlight {
public:
    WorkInFlight() {
        now = State{};
        submit = std::exchange(vkQueueSubmit, on_submit);
        wait_idle = std::exchange(vkDeviceWaitIdle, on_wait_idle);
        wait = std::exchange(vkWaitSemaphores, on_wait);
        destroy = std::exchange(vkDestroyBuffer, on_destroy);
    }
    ~WorkInFlight() {
        vkQueueSubmit = submit;
        vkDeviceWaitIdle = wait_idle;
        vkWaitSemaphores = wait;
        vkDestroyBuffer = destroy;
    }
    WorkInFlight(const WorkInFlight&) = delete;
    WorkInFlight& operator=(const WorkInFlight&) = delete;

    /// Number of destroyed buffers. n_destroyed_in_flight() counts those that were
    /// destroyed between a submission and the next wait for it.
    int n_destroyed() const { return now.n_destroyed; }
    int n_destroyed_in_flight() const { return now.n_destroyed_in_flight; }
    int n_submissions() const { return now.n_submissions; }

private:
    struct State {
        bool in_flight;
        std::uint64_t last_value;  ///< semaphore value of the last submission; 0 if it has none
        int n_destroyed, n_destroyed_in_flight, n_submissions;
    };
    inline static State now;
    inline static PFN_vkQueueSubmit submit;
    inline static PFN_vkDeviceWaitIdle wait_idle;
    inline static PFN_vkWaitSemaphores wait;
    inline static PFN_vkDestroyBuffer destroy;

    static VKAPI_ATTR VkResult VKAPI_CALL on_submit(VkQueue queue, std::uint32_t count,
                                                    const VkSubmitInfo* work, VkFence fence) {
        const auto* values = static_cast<const VkTimelineSemaphoreSubmitInfo*>(work->pNext);
        ++now.n_submissions;
        // The host waits for a submission with a fence immediately.
        now.in_flight = fence == VK_NULL_HANDLE;
        now.last_value = values ? *values->pSignalSemaphoreValues : 0;
        return submit(queue, count, work, fence);
    }
    static VKAPI_ATTR VkResult VKAPI_CALL on_wait_idle(VkDevice device) {
        now.in_flight = false;
        return wait_idle(device);
    }
    static VKAPI_ATTR VkResult VKAPI_CALL on_wait(VkDevice device, const VkSemaphoreWaitInfo* info,
                                                  std::uint64_t timeout) {
        if (*info->pValues == now.last_value) now.in_flight = false;
        return wait(device, info, timeout);
    }
    static VKAPI_ATTR void VKAPI_CALL on_destroy(VkDevice device, VkBuffer buffer,
                                                 const VkAllocationCallbacks* callbacks) {
        ++now.n_destroyed;
        now.n_destroyed_in_flight += now.in_flight;
        destroy(device, buffer, callbacks);
    }
};

}  // namespace relidar::test
