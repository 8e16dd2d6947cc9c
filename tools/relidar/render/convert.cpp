// SPDX-License-Identifier: Apache-2.0
// The command `relidar convert` writes any log as a folder of plain files, or as a
// capture of the sensor's network packets.
#include <fstream>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/log/log_time.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/read/packets.hpp>

#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "render/render_notes.hpp"

namespace relidar::cli {
namespace {

struct ConvertOptions {
    std::string dataset;
    std::string out;
    std::string frames;
    SettingsCommandOptions settings;
    bool overwrite = false;
    bool quiet = false;
};

/// Returns true if a file begins like a network capture: pcap with microseconds or
/// nanoseconds in either byte order, or pcapng.
bool is_capture(const std::filesystem::path& file) {
    std::string first_bytes(4, '\0');
    std::ifstream(file, std::ios::binary).read(first_bytes.data(), 4);
    return first_bytes == "\xd4\xc3\xb2\xa1" || first_bytes == "\xa1\xb2\xc3\xd4" ||
           first_bytes == "\x4d\x3c\xb2\xa1" || first_bytes == "\xa1\xb2\x3c\x4d" ||
           first_bytes == "\x0a\x0d\x0d\x0a";
}

/// Checks that a capture and its calibration file (.csv, .json) replace no needed file.
void check_capture(const std::filesystem::path& capture, const std::string& log_path, bool overwrite) {
    namespace fs = std::filesystem;
    std::error_code failed;
    const bool exists = fs::exists(capture, failed);
    const bool is_in_log =
        fs::equivalent(capture, log_path, failed) || fs::equivalent(folder_of(capture), log_path, failed);
    if (exists && is_in_log)
        fail<UsageError>("--out {}: this file is the log or a part of it; expected another name",
                         capture.string());
    if (exists && !overwrite)
        fail<UsageError>(
            "--out {}: a file with this name exists; expected a new name, or --force to replace the file",
            capture.string());
    if (exists && !is_capture(capture))
        fail<UsageError>("--out {}: the existing file is not a network capture; expected another name",
                         capture.string());
    // If the capture exists, its calibration may exist too and is replaced with it.
    for (const char* extension : {".csv", ".json"}) {
        const fs::path file = fs::path(capture).replace_extension(extension);
        if (!exists && fs::exists(file, failed))
            fail<UsageError>("--out {}: found {}, the name of the calibration; expected another name",
                             capture.string(), file.string());
    }
}

/// Writes the packets that the sensor of the log would send over the network.
void write_log_as_packets(const Log& log, const ConvertOptions& options) {
    const std::filesystem::path out = options.out;
    check_capture(out, log.source, options.overwrite);
    const OutputFolder folder(folder_of(out));
    TerminalProgress progress(options.quiet);
    const std::size_t n_packets = save_packets(log, out, interruptible_progress(progress));
    end_progress();
    note_time_shift(log, time_shift_of(log));
    if (!options.quiet)
        print(fmt::format("wrote {}: {} packets of {} scans\n", absolute_path(options.out), n_packets,
                          log.frames.size()));
}

/// Reads a log and writes it as a folder of plain files or, if the name of the output
/// ends in .pcap, as network packets.
void run_convert(const ConvertOptions& options) {
    check_settings_used(options.settings.sets, {"dataset.", "conventions.", "sensor.rolling_shutter"},
                        "convert");
    Config config = make_config(options.settings);
    config.dataset.path = options.dataset;
    apply_selection(config, {.frames = options.frames, .sequence = ""});
    const Log log = load_dataset(config, options.quiet);
    install_handlers();
    if (std::filesystem::path(options.out).extension() == ".pcap") return write_log_as_packets(log, options);
    TerminalProgress progress(options.quiet);
    // With dataset.poses=none the user says that the poses of the log are wrong.
    const bool has_poses = log.has_poses && config.dataset.poses != kNoPoses;
    save_folder(log, options.out, {options.overwrite, has_poses, interruptible_progress(progress)});
    end_progress();
    if (!options.quiet)
        print(fmt::format("wrote {}: {} scans of {} LiDAR{}, {} boxes\n", absolute_path(options.out),
                          log.frames.size(), log.lidars.size(), log.lidars.size() == 1 ? "" : "s",
                          log.boxes.size()));
}

constexpr const char* kConvertHelp =
    R"(The folder holds all rays, including dropped rays and second returns, and the beams, mountings,
poses and boxes. Reading it gives the same log. docs/datasets.md describes the format; a short
Python script can write it too.
With --out FILE.pcap the command writes a capture with the packets that the sensor would send, for
the driver of its manufacturer. The log must have a single LiDAR whose packet format relidar can write.
Examples:
  relidar convert data/2011_09_26_drive_0005_sync --out log --frames 0:50
  relidar train log --out run
  relidar convert recording.mcap --out packets.pcap)";

}  // namespace

/// Adds the command `relidar convert` and its options to the parser.
void add_convert(CLI::App& app, ParsedCommand& call) {
    CLI::App* command =
        app.add_subcommand("convert", "convert a log to npz, text and JSON files, or to sensor packets");
    const auto options = std::make_shared<ConvertOptions>();
    command->add_option("DATASET", options->dataset, "log: a path, or kind:path")->required();
    add_option(*command, "--out FOLDER|FILE.pcap", options->out, "folder or capture to create")->required();
    add_option(*command, "--frames A:B", options->frames, "frames to convert, first:end (default: all)");
    add_set_option(*command, options->settings.sets);
    command->add_flag("--force", options->overwrite, "replace an existing folder or file of this name");
    add_quiet_option(*command, options->quiet);
    command->footer(kConvertHelp);
    run_after_parsing(*command, call, options, run_convert);
}

}  // namespace relidar::cli
