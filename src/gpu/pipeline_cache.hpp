// SPDX-License-Identifier: Apache-2.0
// Stores compiled pipelines on disk, in one file per device and driver, because a GPU's
// compiler takes seconds for the largest kernels. Ignores a file that is damaged or of
// another driver. A folder that cannot be written is not an error.
#pragma once

#include <filesystem>
#include <string>

#include "gpu/vulkan.hpp"

namespace relidar::gpu {

class PipelineCache {
public:
    /// Reads the cache file.
    /// @param folder  folder of the file; if it is empty, nothing is stored
    PipelineCache(VkPhysicalDevice physical, VkDevice device, const std::filesystem::path& folder);
    /// Writes the file if the cache has grown.
    ~PipelineCache();
    PipelineCache(const PipelineCache&) = delete;
    PipelineCache& operator=(const PipelineCache&) = delete;

    VkPipelineCache handle() const { return handle_; }
    /// Path of the file. Empty if nothing is stored.
    const std::filesystem::path& path() const { return path_; }
    /// Number of bytes that were read from the file, 0 if there was no file.
    std::size_t read_bytes() const { return read_bytes_; }

private:
    VkDevice device_;
    VkPipelineCache handle_ = VK_NULL_HANDLE;
    std::filesystem::path path_;
    std::size_t read_bytes_ = 0;

    void save() const;
};

}  // namespace relidar::gpu
