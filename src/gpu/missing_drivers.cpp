// SPDX-License-Identifier: Apache-2.0
// Finds GPUs in the device files of Linux that no Vulkan driver offers. A GPU in a
// container often has no Vulkan driver, and relidar would use the CPU without a word.
// Also finds drivers that are installed but cannot be loaded.
#include "gpu/missing_drivers.hpp"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include <dlfcn.h>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/gpu/device.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

struct GpuMaker {
    std::uint32_t vendor_id;                  ///< PCI identifier, also in VkPhysicalDeviceProperties
    const char *name, *device_file, *advice;  ///< device_file: in /dev, a number may follow
};
constexpr GpuMaker kGpuMakers[] = {
    {0x10DE, "NVIDIA", "nvidia",
     "install NVIDIA's Vulkan driver; in a container, set NVIDIA_DRIVER_CAPABILITIES=all"},
    {0x1002, "AMD", "kfd", "install Mesa's Vulkan driver (RADV)"},
    {0x8086, "Intel", "", "install Mesa's Vulkan driver (ANV)"}};

/// Returns the device file of a vendor's GPU: for example /dev/nvidia0, /dev/kfd, or a
/// render node in /dev/dri. Empty if there is none.
/// @param device_file start of the name in /dev; a number may follow
fs::path find_device_file(const fs::path& root, std::uint32_t vendor_id, const std::string& device_file) {
    std::error_code failed;
    const auto is_numbered = [&](const std::string& name) {
        return name.starts_with(device_file) &&
               name.find_first_not_of("0123456789", device_file.size()) == std::string::npos;
    };
    for (const auto& entry : fs::directory_iterator(root / "dev", failed))
        if (!device_file.empty() && is_numbered(entry.path().filename().string()) &&
            !entry.is_directory(failed))
            return entry.path();
    // Linux lists the PCI vendor of each render node.
    for (const auto& entry : fs::directory_iterator(root / "sys/class/drm", failed)) {
        const std::string name = entry.path().filename().string();
        const fs::path node = root / "dev/dri" / name;
        std::uint32_t node_vendor_id = 0;
        std::ifstream(entry.path() / "device/vendor") >> std::hex >> node_vendor_id;
        if (name.starts_with("renderD") && node_vendor_id == vendor_id && fs::exists(node, failed))
            return node;
    }
    return {};
}

}  // namespace

std::vector<std::string> find_driverless(const std::vector<DeviceInfo>& devices, const fs::path& root) {
    std::vector<std::string> lines;
    std::error_code failed;  // not read: a folder that cannot be read has no GPU
    const auto add = [&](const std::string& name, const fs::path& file, const char* advice) {
        lines.push_back(fmt::format("{} (/{}) is not used, because no Vulkan driver offers it; {}", name,
                                    file.lexically_relative(root).string(), advice));
    };
    for (const GpuMaker& maker : kGpuMakers) {
        // Vulkan already offers a device of this vendor.
        if (std::ranges::find(devices, maker.vendor_id, &DeviceInfo::vendor_id) != devices.end()) continue;
        const fs::path file = find_device_file(root, maker.vendor_id, maker.device_file);
        if (!file.empty()) add(fmt::format("the {} GPU of this machine", maker.name), file, maker.advice);
    }
    const bool has_gpu = std::ranges::any_of(devices, [](const DeviceInfo& d) { return d.type != "CPU"; });
    // WSL gives access to the GPU of Windows by the file /dev/dxg.
    if (!has_gpu && fs::exists(root / "dev/dxg", failed))
        add("the GPU of Windows", root / "dev/dxg", "install Mesa's Vulkan driver for WSL (dzn)");
    return lines;
}

namespace gpu {
namespace {

/// Returns the paths of driver manifests that the Vulkan loader reads.
std::vector<fs::path> list_manifests() {
    // The first variable that is set replaces the folders of the system.
    std::string paths = "/etc/vulkan/icd.d:/usr/local/share/vulkan/icd.d:/usr/share/vulkan/icd.d";
    for (const char* name : {"VK_ICD_FILENAMES", "VK_DRIVER_FILES"})
        if (const char* value = std::getenv(name); value && *value) paths = value;
    std::vector<fs::path> manifests;
    std::istringstream list(paths);
    for (std::string path; std::getline(list, path, ':');) {
        std::error_code failed;
        if (path.ends_with(".json")) manifests.emplace_back(path);
        for (const auto& entry : fs::directory_iterator(path, failed))
            if (entry.path().extension() == ".json") manifests.push_back(entry.path());
    }
    return manifests;
}

/// Loads the library of a driver manifest.
/// @throws DataError if the manifest cannot be read or the library cannot be loaded
void load_driver(const fs::path& manifest) {
    const std::string file = manifest.string();
    const nlohmann::json root = parse_json(read_text_file(manifest), file);
    const std::string library = JsonField(root, file, "").at("ICD").at("library_path").text();
    // A path with a slash is relative to the manifest. A name is searched by the system.
    const bool is_path = library.find('/') != std::string::npos;
    const std::string path = is_path ? (manifest.parent_path() / library).string() : library;
    if (void* handle = dlopen(path.c_str(), RTLD_LAZY | RTLD_LOCAL)) dlclose(handle);
    else fail("the library {} of the driver manifest {} cannot be loaded: {}", path, file, dlerror());
}

}  // namespace

std::vector<std::string> find_broken_drivers() {
    std::vector<std::string> problems;
    for (const fs::path& manifest : list_manifests()) {
        try {
            load_driver(manifest);
        } catch (const DataError& error) {
            problems.emplace_back(error.what());
        }
    }
    return problems;
}

}  // namespace gpu
}  // namespace relidar
