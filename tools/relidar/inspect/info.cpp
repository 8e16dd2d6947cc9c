// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "inspect/info_text.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

struct InfoOptions {
    std::string path;
    LogSelection part;
    SettingsCommandOptions settings;
    bool json = false;
    bool all = false;
};

template <class Summary>
void print_summary(const Summary& summary, bool json) {
    print(json ? format_as_json(summary) : format_as_text(summary));
}

void print_run_info(const InfoOptions& options) {
    const Run run = load_run(options.path);
    print_summary(summarise_run(run), options.json);
}

/// Prints the state of a run that has no scene yet, and how to continue its training.
void print_unfinished(const std::filesystem::path& folder) {
    const Config config = load_settings(folder / "config.toml");
    const bool is_training = FolderLock::is_locked(folder);  // A training locks its folder.
    print(fmt::format("{}: {}, at iteration {} of {}; it has no saved scene yet; its log is {}\n",
                      folder.string(),
                      is_training ? "a run that is being trained" : "a run whose training was interrupted",
                      last_iteration(folder), config.train.iterations, config.dataset.path));
    if (!is_training)
        print(fmt::format("continue with: relidar train --resume {}\n", quote_for_shell(folder.string())));
}

/// Prints a summary of a log. By default reads only a sample of its scans, because a bag
/// of one hour has 36,000 scans.
void print_log_info(const InfoOptions& options) {
    constexpr std::size_t kMaxSampledScans = 64;
    Config config = make_config(options.settings);
    config.dataset.path = options.path;
    apply_selection(config, options.part);
    const Log log = load_dataset(config, false, options.all ? 0 : int(kMaxSampledScans));
    LogSummary summary = summarise_log(log, config.init);
    const bool is_long = std::ranges::any_of(
        summary.lidars, [](const LidarSummary& lidar) { return lidar.n_frames > kMaxSampledScans; });
    // Some readers read all scans even if fewer are requested.
    summary.is_sample = !options.all && is_long && summary.n_scans_read < log.frames.size();
    print_summary(summary, options.json);
}

/// Prints a summary of a run, of a run that is not finished, or of a log.
void run_info(const InfoOptions& options) {
    const bool has_scene = is_run_folder(options.path);
    const bool is_run = has_scene || contains_run(options.path);
    const std::vector<std::string> log_settings{"dataset.", "conventions.", "sensor.rolling_shutter",
                                                "init."};
    check_settings_used(options.settings.sets, is_run ? std::vector<std::string>{} : log_settings,
                        is_run ? "info RUN" : "info");
    if (is_run && (options.all || !options.part.frames.empty() || !options.part.sequence.empty()))
        fail<UsageError>("--frames, --sequence and --all can only be used with a log; {} is a run",
                         options.path);
    if (has_scene) print_run_info(options);
    else if (is_run) print_unfinished(options.path);
    else print_log_info(options);
}

}  // namespace

/// Adds the command `relidar info` and its options to the parser.
void add_info(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("info", "print a summary of a log or a run");
    const auto options = std::make_shared<InfoOptions>();
    command->add_option("DATASET|RUN", options->path, "log (path, or kind:path) or run folder")->required();
    add_log_options(*command, options->part);
    add_set_option(*command, options->settings.sets);
    command->add_flag("--json", options->json, "print JSON");
    command->add_flag(
        "--all", options->all,
        "read every scan of a log to check that all are readable (default: 64 scans spread over the log)");
    command->footer(
        "Examples:\n"
        "  relidar info data/kitti/2011_09_26/2011_09_26_drive_0005_sync --frames 0:50\n"
        "  relidar info run --json");
    run_after_parsing(*command, call, options, run_info);
}

}  // namespace relidar::cli
