// SPDX-License-Identifier: Apache-2.0
// The command `relidar list devices` prints the Vulkan devices of the machine and their
// features. For each device it also prints the method to trace rays, and why ray queries
// are not available.
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include <relidar/gpu/device.hpp>
#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

std::string backend_name(const DeviceInfo& device_info) {
    switch (best_backend(device_info)) {
        case RayTracingBackend::ray_query: return "ray_query";
        case RayTracingBackend::software: return "software";
        default: return "none";
    }
}

/// Prints all properties of the devices that decide whether and how relidar can use them.
void print_json(const std::vector<DeviceInfo>& devices) {
    nlohmann::ordered_json json = nlohmann::ordered_json::array();
    for (const DeviceInfo& d : devices) {
        json.push_back({{"index", d.index},
                        {"name", d.name},
                        {"type", d.type},
                        {"driver", d.driver},
                        {"api_version", d.api_version},
                        {"memory_bytes", d.memory_bytes},
                        {"ray_query", d.ray_query},
                        {"why_not_ray_query", d.why_not_ray_query},
                        {"software", d.software},
                        {"why_not_software", d.why_not_software},
                        {"float_atomics", d.float_atomics},
                        {"timestamps", d.timestamps},
                        {"usable", d.why_not_usable.empty()},
                        {"why_not_usable", d.why_not_usable},
                        {"traversal", backend_name(d)}});
    }
    print(json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
}

/// Prints a table of the devices, and below it the reasons why features are missing.
void print_table(const std::vector<DeviceInfo>& devices) {
    TableRows rows{{"device", "name", "type", "Vulkan", "memory", "ray query", "software", "float atomics",
                    "traversal"}};
    std::string notes;
    for (const DeviceInfo& device : devices) {
        rows.push_back({fmt::format("{}", device.index), device.name, device.type, device.api_version,
                        format_bytes(device.memory_bytes), device.ray_query ? "yes" : "no",
                        device.software ? "yes" : "no", device.float_atomics ? "yes" : "no",
                        backend_name(device)});
        notes += fmt::format("\n{}  driver: {}", device.index, device.driver);
        if (!device.why_not_usable.empty())
            notes += fmt::format("\n   relidar cannot use this device: missing {}", device.why_not_usable);
        if (!device.why_not_ray_query.empty())
            notes += fmt::format("\n   traversal ray_query is not available: missing {}",
                                 device.why_not_ray_query);
        if (!device.why_not_software.empty())
            notes +=
                fmt::format("\n   traversal software is not available: missing {}", device.why_not_software);
        if (device.why_not_usable.empty() && !device.float_atomics)
            notes += "\n   no float atomics: gradients are added with compare-and-swap, which is slower";
    }
    print(format_table(rows) + notes + "\n");
}

/// Prints all Vulkan devices, and warns about GPUs for which no driver is installed.
void print_devices(const bool& as_json) {
    const std::vector<DeviceInfo> devices = list_devices();
    if (devices.empty())
        throw DeviceError(
            "found no Vulkan device on this machine; expected at least one; tools/dev/setup installs a "
            "driver that renders on the CPU");
    if (as_json) print_json(devices);
    else print_table(devices);
    if (apply_environment().report_missing_drivers)
        for (const std::string& line : find_driverless(devices)) print_warning(line);
}

}  // namespace

/// Adds the command `relidar list devices` and its options to the parser.
void add_list_devices(CLI::App& list_command, ParsedCommand& call) {
    CLI::App* command = list_command.add_subcommand(
        "devices", "list all Vulkan devices, their features and the traversal that relidar would use");
    const auto json = std::make_shared<bool>(false);
    command->add_flag("--json", *json, "print JSON");
    command->footer(
        "The first column is the number for the option --device. \"traversal\" is the method to trace rays "
        "that\nrelidar selects. \"software\" says whether relidar can trace rays on the device without ray "
        "queries.\nExample: relidar list devices");
    run_after_parsing(*command, call, json, print_devices);
}

}  // namespace relidar::cli
