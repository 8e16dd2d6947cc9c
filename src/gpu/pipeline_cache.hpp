// SPDX-License-Identifier: Apache-2.0
// Pipeline cache on disk, because a GPU's compiler needs seconds for the largest kernels.
// There is one file per device and driver. A file that is damaged or from another driver
// is ignored. An unwritable folder is not an error.
#pragma once

#include <filesystem>
#include <string>

#include "gpu/vulkan.hpp"

namespace relidar::gpu {

class PipelineCache {
public:
    /// Opens the cache.
    /// @param folder folder of the file; empty = no file
    PipelineCache(VkPhysicalDevice physical, VkDevice device, const std::filesystem::path& folder);
    /// Writes the file if the cache has grown since it was read.
    ~PipelineCache();
    PipelineCache(const PipelineCache&) = delete;
    PipelineCache& operator=(const PipelineCache&) = delete;

    VkPipelineCache handle() const { return handle_; }
    /// Path of the file; empty without a file.
    const std::filesystem::path& path() const { return path_; }
    /// Number of driver bytes read from the file; 0 if it was missing.
    std::size_t read_bytes() const { return read_bytes_; }

private:
    VkDevice device_;
    VkPipelineCache handle_ = VK_NULL_HANDLE;
    std::filesystem::path path_;
    std::size_t read_bytes_ = 0;

    void save() const;
};

}  // namespace relidar::gpu
