// SPDX-License-Identifier: Apache-2.0
// The command `relidar check` checks that a device gives right results. With --speed, it
// measures how fast the device is.
#include <ctime>
#include <filesystem>
#include <memory>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include <relidar/base/files.hpp>
#include <relidar/gpu/trust.hpp>
#include "base/fail.hpp"
#include "bench/bench.hpp"
#include "bench/case.hpp"
#include "check/checks.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"

namespace relidar::cli {
namespace {

struct CheckOptions : BenchOptions {
    bool speed = false;
};

struct NamedCheckResult {
    std::string name;
    CheckResult finding;
    double seconds = 0.0;
};

const char* outcome_name(CheckOutcome outcome_kind) {
    switch (outcome_kind) {
        case CheckOutcome::right: return "right";
        case CheckOutcome::wrong: return "WRONG";
        default: return "not supported";
    }
}

/// Runs and times one check. If the driver reports an error, the result is "wrong".
/// @param is_device_lost output: set to true if the driver has lost the device
NamedCheckResult run_one_check(const DeviceCheck& check, CheckedDevice& tested, bool& is_device_lost) {
    NamedCheckResult row{check.name, {}, 0.0};
    const Clock::time_point start = Clock::now();
    try {
        row.finding = check.run(tested);
    } catch (const DeviceLost& error) {
        is_device_lost = true;
        row.finding = failed_check(make_one_line(error.what()));
    } catch (const DeviceError& error) {
        row.finding = failed_check(make_one_line(error.what()));
    }
    row.seconds = seconds_since(start);
    return row;
}

/// Returns the results for --json, with the properties of the device.
std::string report_json(const DeviceInfo& device_info, const std::vector<NamedCheckResult>& check_rows) {
    nlohmann::ordered_json json = {{"format", "relidar check"},
                                   {"version", 1},
                                   {"relidar", RELIDAR_VERSION},
                                   {"date", fmt::format("{:%Y-%m-%d}", fmt::gmtime(std::time(nullptr)))},
                                   {"device", device_info.name},
                                   {"type", device_info.type},
                                   {"driver", device_info.driver},
                                   {"api_version", device_info.api_version},
                                   {"memory_bytes", device_info.memory_bytes}};
    for (const NamedCheckResult& row : check_rows) {
        // The terminal shows WRONG in upper case, the file does not.
        const bool is_wrong = row.finding.kind == CheckOutcome::wrong;
        json["checks"].push_back({{"name", row.name},
                                  {"result", is_wrong ? "wrong" : outcome_name(row.finding.kind)},
                                  {"text", row.finding.text},
                                  {"seconds", row.seconds}});
    }
    return json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

/// Returns the built-in checks, and a check of a run's images per ray tracing method.
std::vector<DeviceCheck> list_checks(const std::string& run_folder_or_empty) {
    std::vector<DeviceCheck> checks(builtin_checks().begin(), builtin_checks().end());
    if (run_folder_or_empty.empty()) return checks;
    const auto bench = std::make_shared<const BenchCase>(case_of_run(load_run(run_folder_or_empty)));
    for (const auto& [name, backend] : {std::pair("run, software", RayTracingBackend::software),
                                        {"run, ray query", RayTracingBackend::ray_query}})
        checks.push_back({name, [bench, backend = backend](CheckedDevice& tested) {
                              return check_run_scene(tested, backend, *bench);
                          }});
    return checks;
}

/// Runs all checks on a device and prints a line for each.
/// @throws DeviceError if any result is wrong
void run_all_checks(const CheckOptions& options) {
    // relidar avoids methods that have failed a test at the first use of the device. The
    // checks must use all methods, so results without failures replace the real results.
    const ScopedDeviceTestResults no_failures(DeviceTestResults{});
    CheckedDevice checked(to_device_options(options.device));
    const DeviceInfo& info = checked.default_device().info();
    print(fmt::format("device   {}\ndriver   {}\nrelidar  {}\n\n", info.name, info.driver, RELIDAR_VERSION));
    std::vector<NamedCheckResult> rows;
    std::vector<std::string> wrong_names;
    bool is_lost = false;
    for (const DeviceCheck& check : list_checks(options.run)) {
        check_interrupt();
        rows.push_back(run_one_check(check, checked, is_lost));
        const NamedCheckResult& row = rows.back();
        print(fmt::format("{:<22} {:<13} {:6.2f} s  {}\n", row.name, outcome_name(row.finding.kind),
                          row.seconds, row.finding.text));
        if (row.finding.kind == CheckOutcome::wrong) wrong_names.push_back(row.name);
        if (is_lost) break;
    }

    if (!options.json.empty()) write_text_file(options.json, report_json(info, rows));
    if (wrong_names.empty()) return;
    fail<DeviceError>("{} of {} checks gave wrong results on the device {} ({}): {}{}", wrong_names.size(),
                      rows.size(), info.name, info.driver, fmt::join(wrong_names, ", "),
                      is_lost ? "; the driver has lost the device, so the other checks did not run" : "");
}

/// Runs `relidar check`: checks the results of a device, or measures its speed.
void run_check(const CheckOptions& options) {
    if (std::error_code failed; std::filesystem::is_directory(options.json, failed))
        fail("--json {}: this is a folder; expected the name of a file to write", options.json);
    if (!options.sensor.empty() && (options.run.empty() || !options.speed))
        throw UsageError(
            "--sensor requires both --speed and --run, because only both together measure scans");
    // Creates the folder of the report before the long work starts.
    std::optional<OutputFolder> folder;
    if (!options.json.empty()) folder.emplace(folder_of(options.json));
    install_handlers();
    if (options.speed) run_bench(options);
    else run_all_checks(options);
}

constexpr const char* kCheckHelp =
    R"(Each check compares the results of the device with exact results, or with results that the CPU
computes in double precision. If a result is wrong, the exit code is 4. docs/devices.md says how
to report the results of your device.
--speed renders and trains a synthetic street of 100000 surfels with 64 x 1024 rays, or the scene
of a run. Times are wall times until the device has finished.
Examples:
  relidar check
  relidar check --run run
  relidar check --device 1 --json check.json
  relidar check --speed --run run --json speed.json
  relidar check --speed --run run --sensor rig.json)";

}  // namespace

/// Adds the command `relidar check` and its options to the parser.
void add_check(CLI::App& app, ParsedCommand& call) {
    CLI::App* command =
        app.add_subcommand("check", "check that a device computes correct results, or measure its speed");
    const auto options = std::make_shared<CheckOptions>();
    command->add_flag("--speed", options->speed,
                      "measure the speed of the device instead of checking its results");
    add_option(*command, "--run RUN", options->run,
               "also check the rendered images of this run; with --speed: measure the speed with its scene "
               "and sensor");
    add_option(*command, "--sensor NAME|FILE", options->sensor,
               "with --speed and --run: sensor or rig whose scans per second are measured (default: the "
               "log's sensor)");
    add_option(*command, "--json FILE", options->json, "also write the results to this file");
    add_device_options(*command, options->device);
    command->footer(kCheckHelp);
    run_after_parsing(*command, call, options, run_check);
}

}  // namespace relidar::cli
