// SPDX-License-Identifier: Apache-2.0
// The command `relidar export` writes the surfels of a run as a PLY file for tools of 3D
// Gaussian splatting. It can also write one PLY file per frame, or the path of the
// sensor. The command `relidar edit --from-ply` can read the PLY file.
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include <relidar/log/trajectory_csv.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/surfel_ply.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "render/choose_frames.hpp"
#include "render/export_map.hpp"

namespace relidar::cli {
namespace {

struct ExportOptions {
    std::string run;
    std::string out;
    std::optional<std::string> frames;
    std::optional<std::string> track;
    std::string points;
    std::optional<double> spacing_m;
    DeviceCommandOptions device;
    bool quiet = false;
};

/// Writes the scene of each frame as a PLY file, such as FOLDER/000010.ply. The actors
/// are at their poses, and positions are in relidar's world frame.
void export_frames(const ExportOptions& options) {
    const Run run = load_run(options.run);
    const std::vector<int> positions = select_frames(run, options.frames, options.quiet);
    const LockedFolder folder(options.out);
    const Scene scene = with_all_blocks(run.scene);
    const glm::dvec3& offset = run.sequence.world_offset_m;
    install_handlers();
    TerminalProgress progress(options.quiet);
    for (std::size_t done = 0; done < positions.size(); ++done) {
        check_interrupt();
        progress.show_step("writing scenes", done, positions.size());
        const Frame& frame = run.sequence.frames[std::size_t(positions[done])];
        const Surfels surfels = freeze_scene(scene, pose_instances(scene, run.sequence, timing_of(frame)));
        write_surfels(folder.path() / fmt::format("{:06}.ply", frame.index), surfels,
                      {{"time_s", fmt::format("{}", frame.time_s)},
                       {"add_to_positions_m", fmt::format("{} {} {}", offset.x, offset.y, offset.z)}});
    }
    end_progress();
    if (!options.quiet)
        print(fmt::format("wrote {}: {} file{}\n", absolute_path(options.out), positions.size(),
                          positions.size() == 1 ? "" : "s"));
}

/// Returns the track of an actor, or the path of the sensor if no track is selected.
const PoseTrack& path_of(const Log& log, const PoseTrack& sensor_path,
                         const std::optional<std::string>& track) {
    if (!track) return sensor_path;
    if (const BoxTrack* box = find_box(log, *track)) return box->world_from_box;
    std::vector<std::string> ids;
    for (const BoxTrack& box : log.boxes) ids.push_back(box.id);
    fail<UsageError>("--track {}: the run has no such track{} (tracks: {})", *track,
                     did_you_mean(*track, ids, "\""), fmt::join(ids, ", "));
}

void run_export(const ExportOptions& options) {
    if (options.points.empty() == options.out.empty()) throw UsageError("expected either --out or --points");
    if (!options.points.empty()) {
        if (options.track) throw UsageError("--points and --track cannot be used together");
        return export_map({options.run, options.points, options.spacing_m.value_or(MapOptions{}.spacing_m),
                           options.frames, options.device, options.quiet});
    }
    if (options.spacing_m) throw UsageError("--spacing needs --points");
    const std::filesystem::path out = options.out;
    if (options.track && (options.frames || out.extension() != ".csv"))
        fail<UsageError>("--out {}: expected a name that ends in .csv and no --frames, because of --track",
                         options.out);
    if (options.frames) {
        if (out.has_extension())
            fail<UsageError>("--out {}: found the ending {}; expected a folder, because of --frames",
                             options.out, out.extension().string());
        return export_frames(options);
    }
    const std::optional<std::string> format = find_name(out.extension().string(), {".ply", ".csv"});
    if (!format) {
        const std::string actual_ending =
            out.has_extension() ? "the ending " + out.extension().string() : "no ending";
        fail<UsageError>(
            "--out {}: found {}, expected a name that ends in .ply (surfels) or .csv (the sensor's path)",
            options.out, actual_ending);
    }
    const Run run = load_run(options.run);
    const OutputFolder folder(out.has_parent_path() ? out.parent_path() : ".");
    std::string written;
    if (*format == ".ply") {
        const glm::dvec3& offset = run.sequence.world_offset_m;
        write_surfels(out, with_all_blocks(run.scene),
                      {{"add_to_positions_m", fmt::format("{} {} {}", offset.x, offset.y, offset.z)}});
        written = fmt::format("{} surfels, {} model{}", count_surfels(run.scene), run.scene.models.size(),
                              run.scene.models.size() == 1 ? "" : "s");
    } else {
        const PoseTrack sensor_path = run.sequence.lidar_track(0);
        const PoseTrack& path = path_of(run.sequence, sensor_path, options.track);
        // From the frame of the scene to the world frame of the dataset.
        write_trajectory(out, shift_track(path, run.sequence.world_offset_m));
        written = fmt::format("{} poses", path.pose.size());
    }
    if (!options.quiet) print(fmt::format("{}: {}\n", absolute_path(options.out), written));
}

constexpr const char* kExportHelp =
    R"(Common viewers can show the PLY file: intensity as colour, surfels as flat ellipsoids. Additional
float properties (hit_0..15, drop_0..15, model) let `relidar edit --from-ply` restore exactly the
same scene. If an editor drops them, it must keep the positions of the surfels. Each actor is
stored in the frame of its box, at the origin and not deformed. add_to_positions_m in the header is
the origin of the background in the dataset's world. With --frames all surfels are in
world coordinates; `relidar edit` cannot read such files.
The path has the columns time_s,x,y,z,yaw_deg,pitch_deg,roll_deg in the dataset's world. render
--trajectory and edit --trajectory read it. With --track it has the centre of the actor's box.
--points merges the points of the log's LiDARs without actors to a map in the dataset's world. It has
the mean point of each cell. .las names the coordinate system if the run has a georeference.
Examples:
  relidar export run --out scene.ply
  relidar export run --out frames --frames 10:20
  relidar export run --out trajectory.csv
  relidar export run --out car.csv --track 0
  relidar export run --points map.las --spacing 0.05)";

}  // namespace

void add_export(CLI::App& app, ParsedCommand& call) {
    CLI::App* command =
        app.add_subcommand("export", "write surfels as PLY for 3D Gaussian splatting, or the sensor's path");
    const auto options = std::make_shared<ExportOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train`")->required();
    command
        ->add_option("--out", options->out,
                     "output file: .ply for surfels or .csv for the sensor's path; with --frames a folder")
        ->type_name("FILE.ply|FILE.csv|FOLDER");
    command
        ->add_option("--points", options->points,
                     "write a map of the points of all scans (or of --frames) to a .las, .ply or .pcd file")
        ->type_name("FILE");
    command->add_option("--spacing", options->spacing_m, "size of the cells of --points (default: 0.05)")
        ->type_name("METRES");
    command
        ->add_option("--frames", options->frames,
                     "for each of these frames (FIRST:END, test, train or all), write one file with the "
                     "background and all actors at their poses")
        ->type_name("A:B");
    command
        ->add_option("--track", options->track, "write the path of this actor to the .csv, not the sensor's")
        ->type_name("NAME");
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->quiet);
    command->footer(kExportHelp);
    command->callback([&call, options] { call.run = [options] { run_export(*options); }; });
}

}  // namespace relidar::cli
