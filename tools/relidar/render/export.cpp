// SPDX-License-Identifier: Apache-2.0
// The command `relidar export` writes the surfels of a run as a PLY file for tools of 3D
// Gaussian splatting. It can also write one PLY file per frame, or the path of the
// sensor. The command `relidar edit --from-ply` can read the PLY file.
#include <array>
#include <map>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include <relidar/log/trajectory_csv.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/scene/surfel_ply.hpp>
#include <relidar/simulate/place_points.hpp>
#include <relidar/simulate/point_files.hpp>
#include <relidar/simulate/render.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "render/render_notes.hpp"
#include "render/selection.hpp"

namespace relidar::cli {
namespace {

struct ExportOptions {
    std::string run;
    std::string out;
    std::optional<std::string> frames;
    std::optional<std::string> track;
    std::string points;
    std::string crs;
    bool latitudes = false;
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
    const glm::dvec3& offset = run.log.world_offset_m;
    install_handlers();
    TerminalProgress progress(options.quiet);
    for (std::size_t done = 0; done < positions.size(); ++done) {
        check_interrupt();
        progress.show_step("writing scenes", done, positions.size());
        const Frame& frame = run.log.frames[std::size_t(positions[done])];
        const Surfels surfels = freeze_scene(scene, pose_instances(scene, run.log, timing_of(frame)));
        write_surfels(folder.path() / fmt::format("{:06}.ply", frame.index), surfels,
                      {{"time_s", fmt::format("{}", frame.time_s)},
                       {"add_to_positions_m", fmt::format("{} {} {}", offset.x, offset.y, offset.z)}});
    }
    end_progress();
    if (!options.quiet)
        print(fmt::format("wrote {}: {} file{}\n", absolute_path(options.out), positions.size(),
                          positions.size() == 1 ? "" : "s"));
}

struct MapCell {
    glm::dvec3 sum_m{0.0};  ///< relative to the origin
    double intensity = 0.0;
    std::size_t n = 0;
};

/// Means of the points of each cell of a grid.
class PointMap {
public:
    /// @param origin_m  of the points in the dataset's world, to which cells are aligned
    PointMap(const glm::dvec3& origin_m, double spacing_m) : origin_m_(origin_m), spacing_m_(spacing_m) {}

    void add_points(const LidarPoints& points) {
        for (std::size_t i = 0; i < points.size(); ++i) {
            const glm::dvec3 p(points.position_m[i]), cell = glm::floor((origin_m_ + p) / spacing_m_);
            MapCell& mean = cells_[{cell.x, cell.y, cell.z}];
            mean.sum_m += p;
            mean.intensity += double(points.intensity[i]);
            ++mean.n;
        }
    }
    LidarPoints mean_points() const {
        LidarPoints map;
        for (const auto& [key, cell] : cells_) {
            map.position_m.emplace_back(cell.sum_m / double(cell.n));
            map.intensity.push_back(float(cell.intensity / double(cell.n)));
        }
        return map;
    }

private:
    glm::dvec3 origin_m_;
    double spacing_m_;
    std::map<std::array<double, 3>, MapCell> cells_;
};

/// Returns the frames to render for a map. Leaves out LiDARs without known rays, because
/// they can only repeat recorded scans.
std::vector<int> map_frames(const ExportOptions& options, const Run& run,
                            const std::vector<SimulatedSensor>& sensor_of_lidar) {
    std::vector<int> positions = select_frames(run, options.frames.value_or("all"), options.quiet);
    for (const SimulatedSensor& sensor : sensor_of_lidar) {
        const bool has_rays = sensor.rays.size() > 0 || sensor.pattern;
        if (has_rays) continue;
        print_note(fmt::format("the map is without {}, whose rays are unknown", sensor.name));
        std::erase_if(positions, [&](int position) {
            return run.log.frames[std::size_t(position)].lidar == sensor.lidar;
        });
    }
    if (positions.empty())
        fail<UsageError>("--points: found no scan with known rays, expected frames of a LiDAR that spins");
    return positions;
}

/// Writes a map in the format of the file's extension. A LAS file on the earth names its
/// coordinate system.
/// @param points  relative to the offset of the log's world
void write_map(const ExportOptions& options, LidarPoints points, const Log& log, double spacing_m,
               const std::optional<MapProjector>& map) {
    const std::filesystem::path out = options.points;
    FileMetadata notes{{"relidar", RELIDAR_VERSION},
                       {"run", file_name_of(options.run)},
                       {"spacing_m", fmt::format("{}", spacing_m)}};
    glm::dvec3 origin_m = log.world_offset_m;
    std::string wkt;
    if (map) {
        notes.push_back({"points_in", map->crs()});
        map->project_points(points.position_m, Pose{{1, 0, 0, 0}, origin_m});
        origin_m = map->to_map(origin_m);
        wkt = map->map().wkt();
    } else if (log.georeference && has_proj()) {
        wkt = GeoConverter(*log.georeference).wkt();
    }
    if (out.extension() == ".ply") write_ply(out, points, notes, origin_m);
    else if (out.extension() == ".pcd") write_pcd(out, points, notes, origin_m);
    else write_las(out, points, notes, origin_m, wkt);
    if (out.extension() == ".las" && !map) note_local_las(log, {"las"});
}

/// Renders the background at the poses of the log's LiDARs and writes all points as one
/// file: the mean point of each cell of a grid in the dataset's world.
void export_map(const ExportOptions& options) {
    constexpr double kMinSpacing_m = 1e-3, kMaxSpacing_m = 100.0, kDefaultSpacing_m = 0.05;
    const std::filesystem::path out = options.points;
    const double spacing_m = options.spacing_m.value_or(kDefaultSpacing_m);
    const std::string extension = out.extension().string();
    if (extension != ".las" && extension != ".ply" && extension != ".pcd")
        fail<UsageError>("--points {}: found the ending \"{}\"; expected .las, .ply or .pcd", options.points,
                         extension);
    if (!(spacing_m >= kMinSpacing_m && spacing_m <= kMaxSpacing_m))
        fail<UsageError>("--spacing: found {}; expected metres from {} to {}", spacing_m, kMinSpacing_m,
                         kMaxSpacing_m);
    const OutputFolder folder(folder_of(out));
    Run run = load_run(options.run);
    run.config = with_max_range(std::move(run.config), run.log);
    const Log& log = run.log;
    const std::optional<MapProjector> earth_map = open_map(log, options.crs);
    std::vector<SimulatedSensor> sensor_of_lidar;
    for (std::size_t lidar = 0; lidar < log.lidars.size(); ++lidar)
        sensor_of_lidar.push_back(make_sensor(run.config, log, int(lidar)));
    const std::vector<int> positions = map_frames(options, run, sensor_of_lidar);

    Device device(to_device_options(options.device));
    ScanRenderer renderer(device, run);
    renderer.show_instances(select_instances(run.scene, {"background"}));
    install_handlers();
    TerminalProgress progress(options.quiet);
    PointMap map(log.world_offset_m, spacing_m);
    for (std::size_t done = 0; done < positions.size(); ++done) {
        check_interrupt();
        progress.show_step("rendering the map", done, positions.size());
        const Frame& frame = log.frames[std::size_t(positions[done])];
        const RenderedScan scan =
            renderer.render(sensor_of_lidar[std::size_t(frame.lidar)], frame.time_s, Pose{});
        map.add_points(place_points(scan, run.config, Pose{{1, 0, 0, 0}, log.world_offset_m}));
    }
    end_progress();
    const LidarPoints points = map.mean_points();
    write_map(options, points, log, spacing_m, earth_map);
    if (!options.quiet)
        print(fmt::format("{}: {} points of {} scans\n", absolute_path(options.points), points.size(),
                          positions.size()));
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

/// Writes all surfels of a run as a PLY file, and returns a description of the content.
std::string export_surfels(const std::filesystem::path& out, const Run& run) {
    const glm::dvec3& offset = run.log.world_offset_m;
    write_surfels(out, with_all_blocks(run.scene),
                  {{"add_to_positions_m", fmt::format("{} {} {}", offset.x, offset.y, offset.z)}});
    return fmt::format("{} surfels, {} model{}", count_surfels(run.scene), run.scene.models.size(),
                       run.scene.models.size() == 1 ? "" : "s");
}

/// Writes the path of the sensor or of an actor as CSV, in the dataset's world, on a map
/// or on the earth. Returns a description of the content.
std::string export_path(const ExportOptions& options, const Run& run) {
    const Log& log = run.log;
    const PoseTrack sensor_path = log.lidar_track(0);
    PoseTrack path = shift_track(path_of(log, sensor_path, options.track), log.world_offset_m);
    if (const std::optional<MapProjector> map = open_map(log, options.crs))
        for (Pose& pose : path.pose) pose = map->to_map(pose);
    if (options.latitudes && !log.georeference)
        throw UsageError("--latitudes: the run has no georeference; set it with `relidar edit`");
    write_trajectory(options.out, path,
                     options.latitudes ? std::optional<GeoConverter>(*log.georeference) : std::nullopt);
    return fmt::format("{} poses", path.pose.size());
}

/// Selects what to write by the options and the extension of the output: a map, the
/// scenes of frames, surfels or a path.
void run_export(const ExportOptions& options) {
    if (options.points.empty() == options.out.empty()) throw UsageError("expected either --out or --points");
    if (!options.points.empty()) {
        if (options.track || options.latitudes)
            throw UsageError("--points cannot be used together with --track or --latitudes");
        return export_map(options);
    }
    if (options.latitudes && !options.crs.empty())
        throw UsageError("--latitudes and --crs cannot be used together");
    if (options.spacing_m) throw UsageError("--spacing needs --points");
    const std::filesystem::path out = options.out;
    const std::string extension = out.extension().string();
    if (extension != ".csv" && (options.latitudes || !options.crs.empty()))
        fail<UsageError>("--out {}: found {}, which needs a name that ends in .csv{}", options.out,
                         options.latitudes ? "--latitudes" : "--crs",
                         options.latitudes ? "" : ", or --points");
    if (options.track && (options.frames || extension != ".csv"))
        fail<UsageError>("--out {}: expected a name that ends in .csv and no --frames, because of --track",
                         options.out);
    if (options.frames) {
        if (!extension.empty())
            fail<UsageError>("--out {}: found the ending {}; expected a folder, because of --frames",
                             options.out, extension);
        return export_frames(options);
    }
    const std::optional<std::string> format = find_name(extension, {".ply", ".csv"});
    if (!format)
        fail<UsageError>(
            "--out {}: found {}, expected a name that ends in .ply (surfels) or .csv (the sensor's path)",
            options.out, extension.empty() ? "no ending" : "the ending " + extension);

    const Run run = load_run(options.run);
    const OutputFolder folder(folder_of(out));
    const std::string content = *format == ".ply" ? export_surfels(out, run) : export_path(options, run);
    if (!options.quiet) print(fmt::format("{}: {}\n", absolute_path(options.out), content));
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
the mean point of each cell. If the run has a georeference, --crs gives coordinates of a map, which .las
names. Without --crs, it names a coordinate system only if the axes of the world are those of a map.
Examples:
  relidar export run --out scene.ply
  relidar export run --out frames --frames 10:20
  relidar export run --out trajectory.csv
  relidar export run --out car.csv --track 0
  relidar export run --out path.csv --latitudes
  relidar export run --points map.las --spacing 0.05 --crs EPSG:32632)";

}  // namespace

/// Adds the command `relidar export` and its options to the parser.
void add_export(CLI::App& app, ParsedCommand& call) {
    CLI::App* command =
        app.add_subcommand("export", "write surfels as PLY for 3D Gaussian splatting, or the sensor's path");
    const auto options = std::make_shared<ExportOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train`")->required();
    add_option(*command, "--out FILE.ply|FILE.csv|FOLDER", options->out,
               "output file: .ply for surfels or .csv for the sensor's path; with --frames a folder");
    add_option(*command, "--points FILE", options->points,
               "write a map of the points of all scans (or of --frames) to a .las, .ply or .pcd file");
    add_option(*command, "--spacing METRES", options->spacing_m,
               "size of the cells of --points (default: 0.05)");
    add_option(*command, "--frames A:B", options->frames,
               "for each of these frames (FIRST:END, test, train or all), write one file with the background "
               "and all actors at their poses");
    add_option(*command, "--track NAME", options->track,
               "write the path of this actor to the .csv, not the sensor's");
    add_option(*command, "--crs EPSG:N", options->crs,
               "coordinate system of --points or the .csv (for example EPSG:32632); needs a georeference");
    command->add_flag("--latitudes", options->latitudes,
                      "write latitude_deg,longitude_deg,height_m to the .csv; needs a georeference");
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->quiet);
    command->footer(kExportHelp);
    run_after_parsing(*command, call, options, run_export);
}

}  // namespace relidar::cli
