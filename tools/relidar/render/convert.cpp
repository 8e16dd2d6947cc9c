// SPDX-License-Identifier: Apache-2.0
// The command `relidar convert` writes any log as a folder of plain files, or as a
// capture of the sensor's network packets.
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/log/dataset.hpp>
#include <relidar/log/packets.hpp>

#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"

namespace relidar::cli {
namespace {

struct ConvertOptions {
    std::string dataset;
    std::string out;
    std::string frames;
    Settings settings;
    bool overwrite = false;
    bool quiet = false;
};

/// Writes a log as a capture file with the network packets that the sensor would send.
void convert_to_packets(const Sequence& sequence, const ConvertOptions& options) {
    const std::filesystem::path out = options.out;
    if (!options.overwrite && std::filesystem::exists(out))
        throw UsageError(
            fmt::format("--out {}: a file with this name exists; expected a new name, or --force to "
                        "replace the file",
                        options.out));
    const OutputFolder folder(out.has_parent_path() ? out.parent_path() : ".");
    Progress progress(options.quiet);
    const relidar::Progress shown = make_progress(progress);
    const std::size_t n = save_packets(sequence, out, [&](std::string_view description, double done) {
        stop_if_interrupted();
        shown(description, done);
    });
    end_progress_line();
    if (!options.quiet)
        print(fmt::format("{}: {} packets of {} scans\n", make_absolute_path(options.out), n,
                          sequence.frames.size()));
}

void run_convert(const ConvertOptions& options) {
    check_sets(options.settings.sets, {"dataset.", "sensor.rolling_shutter"}, "convert");
    Config config = resolve(options.settings);
    config.dataset.path = options.dataset;
    if (!options.frames.empty()) {
        const FrameRange range = parse_frames(options.frames);
        config.dataset.frames_begin = range.begin;
        config.dataset.frames_end = range.end;
    }
    const Sequence sequence = load_dataset(config, options.quiet);
    catch_interrupts();
    if (std::filesystem::path(options.out).extension() == ".pcap")
        return convert_to_packets(sequence, options);
    Progress progress(options.quiet);
    const relidar::Progress shown = make_progress(progress);
    const bool has_poses = config.dataset.poses != kNoPoses && sequence.has_poses;
    save_folder(sequence, options.out,
                {options.overwrite, has_poses, [&](std::string_view description, double done) {
                     stop_if_interrupted();
                     shown(description, done);
                 }});
    end_progress_line();
    if (!options.quiet)
        print(fmt::format("wrote {}: {} scans of {} LiDAR{}, {} boxes\n", make_absolute_path(options.out),
                          sequence.frames.size(), sequence.lidars.size(),
                          sequence.lidars.size() == 1 ? "" : "s", sequence.boxes.size()));
}

constexpr const char* kConvertHelp =
    R"(The folder holds all rays, including dropped rays and second returns, and the beams, mountings,
poses and boxes. Reading it gives the same log. docs/datasets.md describes the format; a short
Python script can write it too.
With --out FILE.pcap it is the capture of the packets that the sensor sends, for the drivers of
its maker. The log must have one LiDAR of a product whose packets relidar can write.
Examples:
  relidar convert data/2011_09_26_drive_0005_sync --out log --frames 0:50
  relidar train log --out run
  relidar convert recording.mcap --out packets.pcap)";

}  // namespace

void add_convert(CLI::App& app, Call& call) {
    CLI::App* command =
        app.add_subcommand("convert", "write a log as a folder (npz, text, JSON) or as packets");
    const auto options = std::make_shared<ConvertOptions>();
    command->add_option("DATASET", options->dataset, "log: a path, or kind:path")->required();
    command->add_option("--out", options->out, "folder or capture to create")
        ->required()
        ->type_name("FOLDER|FILE.pcap");
    command->add_option("--frames", options->frames, "frames to convert, first:end (default: all)")
        ->type_name("A:B");
    add_set_option(*command, options->settings.sets);
    command->add_flag("--force", options->overwrite, "replace an existing folder or file of this name");
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer(kConvertHelp);
    command->callback([&call, options] { call.run = [options] { run_convert(*options); }; });
}

}  // namespace relidar::cli
