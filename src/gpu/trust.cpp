// SPDX-License-Identifier: Apache-2.0
#include "gpu/trust.hpp"

#include <fstream>
#include <sstream>

#include <fmt/format.h>

#include "gpu/pipeline_cache.hpp"

namespace relidar {
namespace {

DeviceOpenCallbacks& open_callbacks() {
    static DeviceOpenCallbacks functions;
    return functions;
}

std::string& injected_faults() {
    static std::string faults;
    return faults;
}

struct UnsavedTestResults {
    std::mutex mutex;
    std::map<std::string, DeviceTestResults> by_device;
};
UnsavedTestResults& unsaved_results() {
    static UnsavedTestResults results;
    return results;
}

/// If not null, this thread uses these test results instead of testing a device.
thread_local const DeviceTestResults* fixed_trust = nullptr;

/// Returns the text of the file with a device's test results. A file is accepted only if
/// its content equals this text exactly, so that damaged files are ignored.
std::string format_results(const std::string& driver_version, const DeviceTestResults& results) {
    return fmt::format(
        "relidar {} checked this device at its first use. Delete this file to repeat the check.\n"
        "driver {}\nfloat_atomics {}\nfloat_swaps {}\nsubgroup_size {}\nray_query {}\n",
        RELIDAR_VERSION, driver_version, int(results.float_atomics), int(results.float_swaps),
        results.subgroup_size, int(results.ray_query));
}

/// Reads a file that format_results() has written. Returns nothing if the text differs
/// in any way, for example in the version or the driver.
std::optional<DeviceTestResults> read_results(const std::filesystem::path& path, const std::string& driver) {
    std::ifstream file(path);
    std::stringstream content;
    content << file.rdbuf();
    const std::string text = content.str();
    const std::size_t values = text.find("\nfloat_atomics ");  // first of four lines with results
    if (values == std::string::npos) return std::nullopt;
    // Each line contains a name and a value.
    int atomics = 0, swaps = 0, subgroup_size = 0, ray_query = 0;
    std::string name;
    std::istringstream lines(text.substr(values));
    lines >> name >> atomics >> name >> swaps >> name >> subgroup_size >> name >> ray_query;
    if (ray_query < 0 || ray_query > int(CheckVerdict::wrong)) return std::nullopt;
    const DeviceTestResults results{.float_atomics = atomics != 0,
                                    .float_swaps = swaps != 0,
                                    .subgroup_size = subgroup_size,
                                    .ray_query = CheckVerdict(ray_query)};
    return text == format_results(driver, results) ? std::optional(results) : std::nullopt;
}

}  // namespace

void set_open_callbacks(DeviceOpenCallbacks callbacks) {
    open_callbacks() = std::move(callbacks);
    const std::scoped_lock lock(unsaved_results().mutex);
    unsaved_results().by_device.clear();
}

ScopedDeviceTestResults::ScopedDeviceTestResults(const DeviceTestResults& results)
    : before_(fixed_trust), trust_(results) {
    fixed_trust = &trust_;
}
ScopedDeviceTestResults::~ScopedDeviceTestResults() { fixed_trust = before_; }

namespace gpu {

void inject_faults(const std::string& comma_separated_faults) { injected_faults() = comma_separated_faults; }
bool has_fault(const std::string& fault_name) {
    return ("," + injected_faults() + ",").find("," + fault_name + ",") != std::string::npos;
}

namespace {

/// Returns the file with the results for a device. Empty if the results are not stored:
/// there is no cache, or a test has injected faults, which must not affect later runs.
std::filesystem::path results_path(const DeviceOptions& options, const std::string& device_name) {
    if (options.pipeline_cache.empty() || !injected_faults().empty()) return {};
    return options.pipeline_cache / ("check_" + device_name + ".txt");
}

/// Returns true if the results contain the tests for the traversal method of the device.
/// A check of a device without ray queries does not test them.
bool is_complete(const DeviceTestResults& results, const Device::Impl& device) {
    return device.traversal != RayTracingBackend::ray_query || results.ray_query != CheckVerdict::unknown;
}

}  // namespace

DeviceTestResults check_results(const Device::Impl& device, const DeviceOptions& options) {
    if (fixed_trust) return *fixed_trust;
    if (!open_callbacks().check || options.compile_only) return {};
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(device.physical, &properties);
    const std::string name = cache_file_name(properties);
    const std::filesystem::path path = results_path(options, name);
    // Uses the results of the file or, if it cannot be written, those of this process.
    UnsavedTestResults& unsaved = unsaved_results();
    const std::scoped_lock lock(unsaved.mutex);
    const std::optional<DeviceTestResults> saved = read_results(path, device.info.driver);
    if (saved && is_complete(*saved, device)) return *saved;
    const std::string key = name + " " + injected_faults();
    const auto earlier = unsaved.by_device.find(key);
    if (earlier != unsaved.by_device.end() && is_complete(earlier->second, device)) return earlier->second;

    DeviceOptions check_options = options;
    check_options.index = device.info.index;
    check_options.traversal = device.traversal;
    const DeviceTestResults results = open_callbacks().check(check_options);
    if (!path.empty()) write_cache_file(path, format_results(device.info.driver, results));
    const bool is_saved = read_results(path, device.info.driver).has_value();
    if (!is_saved) unsaved.by_device[key] = results;
    return results;
}

void report_note(const std::string& text) {
    if (open_callbacks().note && !fixed_trust) open_callbacks().note(text);
}

/// Disables features that failed the test of the device, and notes alternatives. Floats
/// are added with float atomics or, without these, with compare-and-swap (`float_swaps`).
/// Software replaces wrong hardware ray queries if it can trace on this device.
void disable_failed(Device::Impl& device, const DeviceTestResults& results) {
    DeviceInfo& info = device.info;
    const auto note = [&](const std::string& text) { report_note(fmt::format("{}: {}", info.name, text)); };
    const bool has_wrong_atomics = info.float_atomics && !results.float_atomics;
    if (has_wrong_atomics) {
        info.float_atomics = false;
        note(
            "atomic additions of floats give wrong sums on this device, so relidar adds gradients without "
            "them");
    }
    const bool has_wrong_swaps = !info.float_atomics && !results.float_swaps;
    if (has_wrong_swaps) {
        device.wrong_sums = true;
        note(
            "all methods of adding floats give wrong sums on this device; relidar can render on it, but "
            "cannot train");
    }
    // A size of 0 means that the driver's default size has passed the test.
    if (results.subgroup_size != 0 && results.subgroup_size != info.subgroup_size) {
        note(
            fmt::format("subgroups of {} lanes give wrong results on this device; relidar uses subgroups of "
                        "{} lanes instead",
                        info.subgroup_size, results.subgroup_size));
        info.subgroup_size = results.subgroup_size;
        device.forced_lanes = true;
    }
    const bool has_wrong_rays =
        device.traversal == RayTracingBackend::ray_query && results.ray_query == CheckVerdict::wrong;
    if (!has_wrong_rays) return;
    note(fmt::format(
        "hardware ray queries of this device find other surfels than a search through all surfels; {}",
        info.software ? "relidar uses software traversal instead"
                      : "images that are rendered with ray queries are wrong; update the driver"));
    if (info.software) device.traversal = RayTracingBackend::software;
}

}  // namespace gpu
}  // namespace relidar
