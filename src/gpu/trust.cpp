// SPDX-License-Identifier: Apache-2.0
#include "gpu/trust.hpp"

#include <fstream>
#include <map>
#include <mutex>
#include <optional>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include "gpu/pipeline_cache.hpp"

namespace relidar {
namespace {

DeviceOpenCallbacks& get_first_use_functions() {
    static DeviceOpenCallbacks functions;
    return functions;
}

std::string& get_injected_faults() {
    static std::string faults;
    return faults;
}

/// Test results of devices that could not be stored in a file. The key consists of the
/// device, the driver and the faults that a test has injected.
struct UnsavedTestResults {
    std::mutex mutex;
    std::map<std::string, DeviceTestResults> by_device;
};
UnsavedTestResults& get_unsaved_check_results() {
    static UnsavedTestResults results;
    return results;
}

/// Test results that a ScopedDeviceTestResults object has set for this thread, or null.
thread_local const DeviceTestResults* fixed_trust = nullptr;

/// Returns the text of the file with a device's test results. A file is accepted only if
/// its content equals this text exactly, so that damaged files are ignored.
std::string format_check_results(const std::string& driver, const DeviceTestResults& trust) {
    return fmt::format(
        "relidar {} checked this device at its first use. Delete this file to repeat the check.\n"
        "driver {}\nfloat_atomics {}\nfloat_swaps {}\nsubgroup_size {}\nray_query {}\n",
        RELIDAR_VERSION, driver, int(trust.float_atomics), int(trust.float_swaps), trust.subgroup_size,
        int(trust.ray_query));
}

std::optional<DeviceTestResults> read_check_results(const std::filesystem::path& path,
                                                    const std::string& driver) {
    std::ifstream file(path);
    std::stringstream content;
    content << file.rdbuf();
    const std::string text = content.str();
    const std::size_t values = text.find("\nfloat_atomics ");
    if (values == std::string::npos) return std::nullopt;
    DeviceTestResults trust;
    int atomics = 0, swaps = 0, ray_query = 0;
    std::string name;
    std::istringstream(text.substr(values)) >> name >> atomics >> name >> swaps >> name >>
        trust.subgroup_size >> name >> ray_query;
    if (ray_query < 0 || ray_query > int(CheckVerdict::wrong)) return std::nullopt;
    trust.float_atomics = atomics != 0;
    trust.float_swaps = swaps != 0;
    trust.ray_query = CheckVerdict(ray_query);
    return text == format_check_results(driver, trust) ? std::optional(trust) : std::nullopt;
}

}  // namespace

void set_first_use_check(DeviceOpenCallbacks first_use_functions) {
    get_first_use_functions() = std::move(first_use_functions);
    const std::scoped_lock lock(get_unsaved_check_results().mutex);
    get_unsaved_check_results().by_device.clear();
}

ScopedDeviceTestResults::ScopedDeviceTestResults(const DeviceTestResults& trust)
    : before_(fixed_trust), trust_(trust) {
    fixed_trust = &trust_;
}
ScopedDeviceTestResults::~ScopedDeviceTestResults() { fixed_trust = before_; }

namespace gpu {

void set_injected_faults(const std::string& faults) { get_injected_faults() = faults; }
bool is_fault_injected(const std::string& fault_name) {
    return ("," + get_injected_faults() + ",").find("," + fault_name + ",") != std::string::npos;
}

DeviceTestResults get_device_check_results(const Device::Impl& device, const DeviceOptions& options) {
    if (fixed_trust) return *fixed_trust;
    if (!get_first_use_functions().check || options.compile_only) return {};
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(device.physical, &properties);
    std::filesystem::path path;
    // Results are not stored if a test has injected faults, because these results must
    // not affect later runs.
    if (!options.pipeline_cache.empty() && get_injected_faults().empty())
        path = options.pipeline_cache / ("check_" + make_device_key(properties) + ".txt");
    const auto is_complete = [&](const std::optional<DeviceTestResults>& trust) {
        return trust && (trust->ray_query != CheckVerdict::unknown ||
                         device.traversal != RayTracingBackend::ray_query);
    };
    const std::string key = make_device_key(properties) + " " + get_injected_faults();
    UnsavedTestResults& unstored = get_unsaved_check_results();
    const std::scoped_lock lock(unstored.mutex);
    const std::optional<DeviceTestResults> saved_results = read_check_results(path, device.info.driver);
    if (is_complete(saved_results)) return *saved_results;
    const auto checked_before = unstored.by_device.find(key);
    if (checked_before != unstored.by_device.end() && is_complete(checked_before->second))
        return checked_before->second;
    DeviceOptions check_options = options;
    check_options.index = device.info.index;
    check_options.traversal = device.traversal;
    const DeviceTestResults trust = get_first_use_functions().check(check_options);
    if (!path.empty()) replace_file_atomically(path, format_check_results(device.info.driver, trust));
    if (!read_check_results(path, device.info.driver)) unstored.by_device[key] = trust;
    return trust;
}

void apply_device_check_results(Device::Impl& device, const DeviceTestResults& trust) {
    DeviceInfo& info = device.info;
    const auto note = [&](const std::string& text) {
        if (get_first_use_functions().note && !fixed_trust)
            get_first_use_functions().note(fmt::format("{}: {}", info.name, text));
    };
    if (!trust.float_atomics && info.float_atomics) {
        info.float_atomics = false;
        note(
            "atomic additions of floats give wrong sums on this device, so relidar adds gradients without "
            "them");
    }
    if (!trust.float_swaps && !info.float_atomics) {
        device.wrong_sums = true;
        note(
            "all methods of adding floats give wrong sums on this device; relidar can render on it, but "
            "cannot train");
    }
    if (trust.subgroup_size != 0 && trust.subgroup_size != info.subgroup_size) {
        note(
            fmt::format("subgroups of {} lanes give wrong results on this device; relidar uses subgroups of "
                        "{} lanes instead",
                        info.subgroup_size, trust.subgroup_size));
        info.subgroup_size = trust.subgroup_size;
        device.forced_lanes = true;
    }
    if (trust.ray_query != CheckVerdict::wrong || device.traversal != RayTracingBackend::ray_query) return;
    note(fmt::format(
        "hardware ray queries of this device find other surfels than a search through all surfels; {}",
        info.software ? "relidar uses software traversal instead"
                      : "images that are rendered with them are wrong"));
    if (info.software) device.traversal = RayTracingBackend::software;
}

}  // namespace gpu
}  // namespace relidar
