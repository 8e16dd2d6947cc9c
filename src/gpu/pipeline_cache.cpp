// SPDX-License-Identifier: Apache-2.0
// Reads and writes the pipeline cache file. The file contains "RELIDAR1", the size and
// the hash of the remaining data, and then the driver's data.
#include "gpu/pipeline_cache.hpp"

#include <unistd.h>

#include <cstring>
#include <fstream>

#include <fmt/format.h>

#include "base/text_hash.hpp"
#include "gpu/context.hpp"

namespace relidar::gpu {

namespace {

struct PipelineCacheHeader {
    std::array<char, 8> magic{'R', 'E', 'L', 'I', 'D', 'A', 'R', '1'};
    std::uint64_t n_bytes = 0;
    std::uint64_t hash = 0;
};

/// Returns the header of a cache file with this data of the driver.
PipelineCacheHeader make_cache_header(std::string_view cache_data) {
    PipelineCacheHeader header;
    header.n_bytes = cache_data.size();
    // The hash detects damaged files. A damaged file could crash the driver, because
    // drivers check only the header of their data.
    header.hash = hash_text(cache_data);
    return header;
}

/// Returns the driver's data from a cache file. Empty if the file is missing, truncated,
/// damaged, or written by another driver.
std::string read_cache(const std::filesystem::path& path, const VkPhysicalDeviceProperties& properties) {
    std::ifstream file(path, std::ios::binary);
    PipelineCacheHeader header;
    if (!file.read(reinterpret_cast<char*>(&header), sizeof header)) return {};
    std::error_code failed;
    const std::uintmax_t file_bytes = std::filesystem::file_size(path, failed);
    const bool is_complete = !failed && file_bytes - sizeof header == header.n_bytes;
    if (!is_complete) return {};
    std::string bytes(header.n_bytes, '\0');
    VkPipelineCacheHeaderVersionOne driver{};
    if (bytes.size() < sizeof driver || !file.read(bytes.data(), static_cast<std::streamsize>(bytes.size())))
        return {};

    const PipelineCacheHeader expected = make_cache_header(bytes);
    const bool is_intact = header.magic == expected.magic && header.hash == expected.hash;
    std::memcpy(&driver, bytes.data(), sizeof driver);
    const bool is_same_driver =
        driver.headerVersion == VK_PIPELINE_CACHE_HEADER_VERSION_ONE &&
        driver.vendorID == properties.vendorID && driver.deviceID == properties.deviceID &&
        std::memcmp(driver.pipelineCacheUUID, properties.pipelineCacheUUID, VK_UUID_SIZE) == 0;
    return is_intact && is_same_driver ? bytes : std::string();
}

}  // namespace

void write_cache_file(const std::filesystem::path& path, std::string_view bytes) {
    std::error_code failed;
    std::filesystem::create_directories(path.parent_path(), failed);
    // Distinguishes temporary files, because a process may close devices simultaneously.
    static std::atomic<unsigned> count{0};
    const std::filesystem::path temporary = fmt::format("{}.{}-{}", path.string(), ::getpid(), count++);
    std::ofstream file(temporary, std::ios::binary);
    file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    file.close();
    if (file) std::filesystem::rename(temporary, path, failed);
    if (!file || failed) std::filesystem::remove(temporary, failed);
}

std::string cache_file_name(const VkPhysicalDeviceProperties& properties) {
    std::string uuid;
    for (const std::uint8_t byte : properties.pipelineCacheUUID) uuid += fmt::format("{:02x}", byte);
    return fmt::format("{:04x}_{:04x}_{}", properties.vendorID, properties.deviceID, uuid);
}

/// Creates the driver's pipeline cache with the data of an earlier process, so that it
/// need not compile the same kernels again.
PipelineCache::PipelineCache(VkPhysicalDevice physical, VkDevice device, const std::filesystem::path& folder)
    : device_(device) {
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(physical, &properties);
    if (!folder.empty()) path_ = folder / ("pipelines_" + cache_file_name(properties));

    const std::string bytes = path_.empty() ? std::string() : read_cache(path_, properties);
    read_bytes_ = bytes.size();
    VkPipelineCacheCreateInfo info{VK_STRUCTURE_TYPE_PIPELINE_CACHE_CREATE_INFO};
    info.initialDataSize = bytes.size();
    info.pInitialData = bytes.data();
    if (vkCreatePipelineCache(device, &info, nullptr, &handle_) == VK_SUCCESS) {
        set_object_name(device, VK_OBJECT_TYPE_PIPELINE_CACHE, handle_, "pipelines of relidar");
        return;
    }
    handle_ = VK_NULL_HANDLE;  // Without a handle, pipelines are created without a cache.
    path_.clear();
}

/// Writes the driver's data to the file, if it has grown since it was read.
void PipelineCache::save() const {
    std::size_t n_bytes = 0;
    if (vkGetPipelineCacheData(device_, handle_, &n_bytes, nullptr) != VK_SUCCESS || n_bytes <= read_bytes_)
        return;
    // Does not write data without a complete header. The lavapipe of Mesa 26.2 returns
    // such data (20 bytes).
    if (n_bytes < sizeof(VkPipelineCacheHeaderVersionOne)) return;
    std::string bytes(n_bytes, '\0');
    if (vkGetPipelineCacheData(device_, handle_, &n_bytes, bytes.data()) != VK_SUCCESS) return;
    bytes.resize(n_bytes);
    const PipelineCacheHeader header = make_cache_header(bytes);
    write_cache_file(path_, std::string(reinterpret_cast<const char*>(&header), sizeof header) + bytes);
}

PipelineCache::~PipelineCache() {
    if (!path_.empty()) save();
    vkDestroyPipelineCache(device_, handle_, nullptr);
}

}  // namespace relidar::gpu
