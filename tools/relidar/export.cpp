// SPDX-License-Identifier: Apache-2.0
// relidar export and relidar import: the surfels of a run as a PLY file that tools for 3D Gaussian splatting open, and back; the path of
// its sensor as a trajectory.
#include <memory>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "command.hpp"
#include "console.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include <relidar/export.hpp>
#include <relidar/run.hpp>

namespace relidar::cli {
namespace {

struct ExportOptions {
    std::string run;
    std::string out;
    bool quiet = false;
};

struct ImportOptions {
    std::string file;
    std::string run;
    std::string out;
    bool force = false;
    bool quiet = false;
};

std::string sizes(const Scene& scene) {
    return fmt::format("{} surfels, {} model{}", count_surfels(scene), scene.models.size(), scene.models.size() == 1 ? "" : "s");
}

/// Where the log's first sensor was, in the dataset's world.
PoseTrack sensor_path(const Sequence& sequence) {
    return shifted_track(sequence.world_from_sensor(0), sequence.world_offset_m);
}

void run_export(const ExportOptions& options) {
    const std::filesystem::path out = options.out;
    const std::optional<std::string> format = known_name(out.extension().string(), {".ply", ".csv"});
    if (!format) {
        const std::string found = out.has_extension() ? "the ending " + out.extension().string() : "no ending";
        throw UsageError(
            fmt::format("--out {}: found {}, expected a name that ends in .ply (surfels) or .csv (the sensor's path)", options.out, found));
    }
    const Run run = load_run(options.run, note);
    const OutputFolder folder(out.has_parent_path() ? out.parent_path() : ".");
    if (*format == ".ply") write_surfel_ply(out, whole_scene(run.scene));
    else write_trajectory(out, sensor_path(run.sequence));
    const std::string written = *format == ".ply" ? sizes(run.scene) : fmt::format("{} poses", run.sequence.world_from_vehicle.pose.size());
    if (!options.quiet) print(fmt::format("{}: {}\n", absolute_path(options.out), written));
}

void run_import(const ImportOptions& options) {
    const RunFolder folder(options.out, options.force ? Existing::replace : Existing::refuse);
    Run run = load_run(options.run, note);
    run.scene = read_surfel_ply(options.file, whole_scene(run.scene), run.config.image.primitive);
    remove_run_files(folder.path());
    remove_blocks(folder.path());
    run.folder = folder.path();
    save_run(run);
    if (!options.quiet) print(fmt::format("{}: {}\n", absolute_path(options.out), sizes(run.scene)));
}

}  // namespace

void add_export(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand(
        "export", "write the surfels of a run as PLY, in the layout of 3D Gaussian splatting; or the path of its sensor as CSV");
    const auto options = std::make_shared<ExportOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train`")->required();
    command->add_option("--out", options->out, "file to write: surfels, or the sensor's path")->required()->type_name("FILE.ply|FILE.csv");
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer(
        "Common viewers show it: intensity as colour, flat ellipsoids. Further float properties hold hit_0..15, drop_0..15 and model, so "
        "that\n"
        "`relidar import` gives back the same scene bit by bit. Actors are in the frames of their boxes, at the origin.\n"
        "The path is time_s,x,y,z,yaw_deg,pitch_deg,roll_deg in the dataset's world, as render --trajectory and edit --trajectory read "
        "it.\n"
        "Examples:\n"
        "  relidar export run --out scene.ply\n"
        "  relidar export run --out trajectory.csv");
    command->callback([&call, options] { call.run = [options] { run_export(*options); }; });
}

void add_import(CLI::App& app, Call& call) {
    CLI::App* command =
        app.add_subcommand("import", "make a run of a PLY file that `relidar export` wrote and another tool may have edited");
    const auto options = std::make_shared<ImportOptions>();
    command->add_option("FILE", options->file, "PLY file with the properties that `relidar export` writes")->required();
    command->add_option("--run", options->run, "run it came from: settings, sensor, poses, boxes and names of models")
        ->required()
        ->type_name("RUN");
    command->add_option("--out", options->out, "run folder to make")->required()->type_name("RUN2");
    command->add_flag("--force", options->force, "overwrite the run in RUN2");
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer("Example: relidar import scene.ply --run run --out cleaned");
    command->callback([&call, options] { call.run = [options] { run_import(*options); }; });
}

}  // namespace relidar::cli
