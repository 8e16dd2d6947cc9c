// SPDX-License-Identifier: Apache-2.0
// Compiled pipelines, kept on disk from one process to the next: a card's compiler takes
// seconds for the heaviest kernels. A file a device and driver. A file that is damaged or
// of another driver counts as absent, and a folder that cannot be written is no error.
#pragma once

#include <filesystem>
#include <string>

#include "gpu/vulkan.hpp"

namespace relidar::gpu {

class PipelineCache {
public:
    /// @param folder  of the file; empty: nothing is kept
    PipelineCache(VkPhysicalDevice physical, VkDevice device, const std::filesystem::path& folder);
    /// Writes the file where there is more to keep than was read.
    ~PipelineCache();
    PipelineCache(const PipelineCache&) = delete;
    PipelineCache& operator=(const PipelineCache&) = delete;

    VkPipelineCache handle() const { return handle_; }
    /// Empty where nothing is kept.
    const std::filesystem::path& path() const { return path_; }
    /// Bytes of the driver that the file gave, 0 where it was absent.
    std::size_t read_bytes() const { return read_bytes_; }

private:
    VkDevice device_;
    VkPipelineCache handle_ = VK_NULL_HANDLE;
    std::filesystem::path path_;
    std::size_t read_bytes_ = 0;

    void save() const;
};

}  // namespace relidar::gpu
