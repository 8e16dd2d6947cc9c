// SPDX-License-Identifier: Apache-2.0
// Stores compiled pipelines on disk, because a GPU's compiler needs seconds for the
// largest kernels. Each combination of device and driver has a separate file. Damaged
// files and files of other drivers are ignored. A folder without write permission is not
// an error.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "gpu/vulkan.hpp"

namespace relidar::gpu {

/// Writes a file atomically. Ignores failures, which only make the next start slower.
void write_cache_file(const std::filesystem::path& path, std::string_view bytes);

std::string cache_file_name(const VkPhysicalDeviceProperties& properties);

class PipelineCache {
public:
    PipelineCache(VkPhysicalDevice physical, VkDevice device, const std::filesystem::path& folder);
    ~PipelineCache();
    PipelineCache(const PipelineCache&) = delete;
    PipelineCache& operator=(const PipelineCache&) = delete;

    VkPipelineCache handle() const { return handle_; }
    const std::filesystem::path& path() const { return path_; }
    std::size_t loaded_bytes() const { return read_bytes_; }

private:
    VkDevice device_;
    VkPipelineCache handle_ = VK_NULL_HANDLE;
    std::filesystem::path path_;
    std::size_t read_bytes_ = 0;

    void save() const;
};

}  // namespace relidar::gpu
