// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <charconv>
#include <cstdlib>

#include "base/fail.hpp"
#include "gpu/trust.hpp"

namespace relidar {

namespace {

// Variables with which users select drivers (documentation of the Vulkan loader).
constexpr std::array kDriverVariables = {"VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES",
                                         "VK_LOADER_DRIVERS_SELECT", "VK_LOADER_DRIVERS_DISABLE"};

std::string read_variable(const char* name) {
    const char* text = std::getenv(name);
    return text ? text : "";
}

/// Converts a memory limit in MiB to bytes.
/// @throws UsageError if the text is not a whole number above 0
std::uint64_t parse_limit(const std::string& mib_text) {
    constexpr std::uint64_t kMaxMib = 1u << 30;  // avoids an overflow of the number of bytes
    std::uint64_t mib = 0;
    const char* end = mib_text.data() + mib_text.size();
    const auto [parsed_end, failed] = std::from_chars(mib_text.data(), end, mib);
    const bool is_number = failed == std::errc() && parsed_end == end;
    if (!is_number || mib == 0 || mib > kMaxMib) {
        fail<UsageError>(
            "environment variable RELIDAR_MEMORY_LIMIT_MIB: found '{}', expected a number of MiB above 0",
            mib_text);
    }
    return mib << 20;
}

std::filesystem::path user_cache_folder() {
    const std::string relidar_cache = read_variable("RELIDAR_PIPELINE_CACHE"),
                      cache = read_variable("XDG_CACHE_HOME"), home = read_variable("HOME");
    if (relidar_cache == "0") return {};
    if (!relidar_cache.empty()) return relidar_cache;
    if (!cache.empty()) return std::filesystem::path(cache) / "relidar";
    return home.empty() ? std::filesystem::path() : std::filesystem::path(home) / ".cache" / "relidar";
}

}  // namespace

DeviceOptions apply_environment(DeviceOptions options) {
    if (read_variable("RELIDAR_VALIDATION") == "1") options.validation = true;
    // If the user has selected drivers, missing drivers are intended.
    options.report_missing_drivers =
        std::ranges::all_of(kDriverVariables, [](const char* name) { return !std::getenv(name); });
    const std::string limit = read_variable("RELIDAR_MEMORY_LIMIT_MIB");
    if (!limit.empty() && options.memory_limit_bytes == 0) options.memory_limit_bytes = parse_limit(limit);
    if (options.pipeline_cache.empty()) options.pipeline_cache = user_cache_folder();
#ifdef RELIDAR_ASSERTS
    gpu::inject_faults(read_variable("RELIDAR_FAULTS"));
#endif
    return options;
}

}  // namespace relidar
