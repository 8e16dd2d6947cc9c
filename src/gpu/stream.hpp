// SPDX-License-Identifier: Apache-2.0
// Recording and submission. run() is one call: parameters are copied into a ring of host-visible memory, the kernel gets their
// address, and a full barrier follows. Submissions overlap with the host: a slot is reused only when the device is done with it.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "gpu/buffer.hpp"
#include "gpu/kernel.hpp"

namespace relidar {

struct KernelBase::Impl {
    Device::Impl* device = nullptr;
    std::string name;
    VkPipeline pipeline = VK_NULL_HANDLE;
    std::uint32_t workgroup_size = 0;   ///< threads
    ~Impl();
};

struct Stream::Impl {
    static constexpr std::size_t kSlots = 3;             ///< submissions in flight
    static constexpr std::size_t kParamBytes = 1 << 16;  ///< parameter structs of one submission
    static constexpr std::uint32_t kMaxLaunches = 256;   ///< timed launches of one submission

    struct Slot {
        VkCommandPool pool = VK_NULL_HANDLE;
        VkCommandBuffer commands = VK_NULL_HANDLE;
        VkQueryPool queries = VK_NULL_HANDLE;
        std::vector<std::string> launches;   ///< names, in order of their timestamp pairs
        std::size_t param_bytes = 0;
        std::uint64_t ticket = 0;            ///< 0 = never submitted
    };

    Device* owner = nullptr;
    Device::Impl* device = nullptr;
    bool timing = false;
    std::unique_ptr<Buffer::Impl> params;
    std::array<Slot, kSlots> slots;
    std::size_t current = 0;
    bool recording = false;
    VkSemaphore timeline = VK_NULL_HANDLE;
    std::uint64_t last_ticket = 0;
    std::string last_kernel = "none";
    KernelTimes times;

    Impl(Device& device, bool timing);
    ~Impl();

    /// Command buffer being recorded, begun where needed.
    VkCommandBuffer commands();
    void barrier();
    void begin_timing(const std::string& name);
    void end_timing();
    /// Copies a parameter struct into the ring. @return its device address
    std::uint64_t store(const void* bytes, std::size_t n_bytes);
    /// Records a small copy from host memory into a buffer.
    void write(const Buffer& buffer, const void* bytes, std::size_t n_bytes);
    void launch(const KernelBase& kernel, std::uint32_t n_threads, const void* params, std::size_t n_bytes);
    void wait(std::uint64_t ticket);
    void collect_times(Slot& slot);
};

/// Runs one kernel over n_threads threads. Sees the results of everything recorded before.
template <class Params>
void run(Stream& stream, const Kernel<Params>& kernel, std::size_t n_threads, const Params& params) {
    if (n_threads) stream.impl().launch(kernel, static_cast<std::uint32_t>(n_threads), &params, sizeof(Params));
}

}  // namespace relidar
