// SPDX-License-Identifier: Apache-2.0
// The command `relidar check` checks that a device gives right results. With --speed, it
// measures how fast the device is.
#include <chrono>
#include <ctime>
#include <filesystem>
#include <memory>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/files.hpp>
#include <relidar/gpu/trust.hpp>
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

using Clock = std::chrono::steady_clock;

struct CheckOptions {
    std::string json, run, sensor;
    bool speed = false;
    DeviceChoice device;
};

/// A check that was run.
struct CheckRow {
    std::string name;
    Finding finding;
    double seconds = 0.0;
};

const char* get_word(Finding::Kind kind) {
    switch (kind) {
        case Finding::Kind::right:
            return "right";
        case Finding::Kind::wrong:
            return "WRONG";
        default:
            return "not supported";
    }
}

/// Runs one check and measures its time. If the driver reports an error, the result of
/// the check is "wrong".
/// @param is_lost output: set to true if the driver has lost the device
CheckRow run_check(const Check& check, CheckedDevice& checked, bool& is_lost) {
    CheckRow row{check.name, {}, 0.0};
    const Clock::time_point start = Clock::now();
    try {
        row.finding = check.run(checked);
    } catch (const DeviceLost& error) {
        is_lost = true;
        row.finding = make_wrong_finding(join_lines(error.what()));
    } catch (const DeviceError& error) {
        row.finding = make_wrong_finding(join_lines(error.what()));
    }
    row.seconds = std::chrono::duration<double>(Clock::now() - start).count();
    return row;
}

std::string check_json(const DeviceInfo& info, const std::vector<CheckRow>& rows) {
    nlohmann::ordered_json json = {{"format", "relidar check"},
                                   {"version", 1},
                                   {"relidar", RELIDAR_VERSION},
                                   {"date", fmt::format("{:%Y-%m-%d}", fmt::gmtime(std::time(nullptr)))},
                                   {"device", info.name},
                                   {"type", info.type},
                                   {"driver", info.driver},
                                   {"api_version", info.api_version},
                                   {"memory_bytes", info.memory_bytes}};
    for (const CheckRow& row : rows)
        json["checks"].push_back(
            {{"name", row.name},
             {"result", row.finding.kind == Finding::Kind::wrong ? "wrong" : get_word(row.finding.kind)},
             {"text", row.finding.text},
             {"seconds", row.seconds}});
    return json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

/// Returns all checks. If a run is given, also the checks of its scene.
std::vector<Check> list_checks(const std::string& run_folder) {
    std::vector<Check> checks(list_all_checks().begin(), list_all_checks().end());
    if (run_folder.empty()) return checks;
    const auto bench = std::make_shared<const BenchCase>(make_run_case(load_run(run_folder)));
    checks.push_back(
        {"run, software", [bench](CheckedDevice& c) { return check_run(c, Traversal::software, *bench); }});
    checks.push_back(
        {"run, ray query", [bench](CheckedDevice& c) { return check_run(c, Traversal::ray_query, *bench); }});
    return checks;
}

void run_checks(const CheckOptions& options) {
    // By default, relidar avoids methods that fail on the device. This setting turns that
    // off, so that the checks show whether the driver computes correctly.
    const Trusting trusting(DeviceTrust{});
    CheckedDevice checked(make_device_options(options.device));
    const DeviceInfo& info = checked.device().info();
    print(fmt::format("device   {}\ndriver   {}\nrelidar  {}\n\n", info.name, info.driver, RELIDAR_VERSION));
    std::vector<CheckRow> rows;
    std::vector<std::string> wrong_names;
    bool is_lost = false;
    for (const Check& check : list_checks(options.run)) {
        stop_if_interrupted();
        rows.push_back(run_check(check, checked, is_lost));
        const CheckRow& row = rows.back();
        print(fmt::format("{:<22} {:<13} {:6.2f} s  {}\n", row.name, get_word(row.finding.kind), row.seconds,
                          row.finding.text));
        if (row.finding.kind == Finding::Kind::wrong) wrong_names.push_back(row.name);
        if (is_lost) break;
    }
    if (!options.json.empty()) write_text(options.json, check_json(info, rows));
    if (wrong_names.empty()) return;
    throw DeviceError(fmt::format("{} of {} checks of {} ({}) are wrong: {}{}", wrong_names.size(),
                                  rows.size(), info.name, info.driver, fmt::join(wrong_names, ", "),
                                  is_lost ? "; the device was lost, so the other checks did not run" : ""));
}

void check_device(const CheckOptions& options) {
    if (std::error_code failed; std::filesystem::is_directory(options.json, failed))
        throw DataError(
            fmt::format("--json {}: this is a folder; expected the name of a file to write", options.json));
    if (!options.sensor.empty() && (options.run.empty() || !options.speed))
        throw UsageError("--sensor can only be used with --speed and --run, because only they measure scans");
    std::optional<OutputFolder> folder;
    if (const std::filesystem::path json = options.json; !json.empty())
        folder.emplace(json.has_parent_path() ? json.parent_path() : ".");
    catch_interrupts();
    if (options.speed) measure_speed({options.run, options.sensor, options.json, options.device});
    else run_checks(options);
}

constexpr const char* kCheckHelp =
    R"(Each check compares kernels with results that the host knows exactly or computes in
double precision. If a check is wrong, the exit code is 4. docs/devices.md says how to report
the results of your device.
--speed measures a street of 100000 surfels and 64 x 1024 rays, or a run. Times are wall
times until the device has finished.
Examples:
  relidar check
  relidar check --run run
  relidar check --device 1 --json check.json
  relidar check --speed --run run --json speed.json
  relidar check --speed --run run --sensor rig.json)";

}  // namespace

void add_check(CLI::App& app, Call& call) {
    CLI::App* command =
        app.add_subcommand("check", "check that a device gives right results, or measure its speed");
    const auto options = std::make_shared<CheckOptions>();
    command->add_flag("--speed", options->speed, "measure the speed of the device instead");
    command
        ->add_option("--run", options->run,
                     "also check the images of this run; with --speed: measure on its scene and sensor")
        ->type_name("RUN");
    command
        ->add_option(
            "--sensor", options->sensor,
            "with --speed and --run: sensor or rig whose scans per second are measured (default: the log's "
            "sensor)")
        ->type_name("NAME|FILE");
    command->add_option("--json", options->json, "also write the results to this file")->type_name("FILE");
    add_device_options(*command, options->device);
    command->footer(kCheckHelp);
    command->callback([&call, options] { call.run = [options] { check_device(*options); }; });
}

}  // namespace relidar::cli
