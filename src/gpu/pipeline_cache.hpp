// SPDX-License-Identifier: Apache-2.0
// Stores compiled pipelines on disk, because a GPU's compiler needs seconds for the
// largest kernels. Each device and driver has one file. Ignores damaged files and files
// from another driver. An unwritable folder is not an error.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "gpu/vulkan.hpp"

namespace relidar::gpu {

/// Writes a file of the cache folder atomically, because other processes may access it at
/// the same time. Ignores failures, because a missing file only costs time.
void replace_file(const std::filesystem::path& path, std::string_view bytes);

/// Returns a name for files that belong to one device and one version of its driver.
std::string device_key(const VkPhysicalDeviceProperties& properties);

class PipelineCache {
public:
    /// Opens the pipeline cache.
    /// @param folder folder of the cache file. Empty for no file.
    PipelineCache(VkPhysicalDevice physical, VkDevice device, const std::filesystem::path& folder);
    /// Writes the cache file if the cache has grown since the file was read.
    ~PipelineCache();
    PipelineCache(const PipelineCache&) = delete;
    PipelineCache& operator=(const PipelineCache&) = delete;

    VkPipelineCache handle() const { return handle_; }
    /// Returns the path of the cache file. Returns an empty path if the cache has no
    /// file.
    const std::filesystem::path& path() const { return path_; }
    /// Returns the number of bytes read from the cache file. Returns 0 if the file was
    /// missing.
    std::size_t read_bytes() const { return read_bytes_; }

private:
    VkDevice device_;
    VkPipelineCache handle_ = VK_NULL_HANDLE;
    std::filesystem::path path_;
    std::size_t read_bytes_ = 0;

    void save() const;
};

}  // namespace relidar::gpu
