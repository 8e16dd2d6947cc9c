// SPDX-License-Identifier: Apache-2.0
// The command `relidar render` renders scans of a run and writes them to files. The
// sensor is at its recorded poses, at shifted poses, or on a path of the user. The sensor
// may be the log's sensor or another sensor.
#include <algorithm>
#include <charconv>
#include <iterator>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include <relidar/log/channels.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/read/packets.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/camera.hpp>
#include <relidar/simulate/dataset_layouts.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "ranks.hpp"
#include "render/dataset_view.hpp"
#include "render/recording_names.hpp"
#include "render/render_notes.hpp"
#include "render/selection.hpp"
#include "render/trajectory.hpp"

namespace relidar::cli {
namespace {

struct RenderOptions {
    std::string run, out;
    std::optional<std::string> frames;
    std::string offset;
    TrajectoryOptions trajectory;
    std::string lidar;
    std::string sensor;
    std::string vehicle_name;            ///< argument of --vehicle
    std::optional<std::string> formats;  ///< without a value: npz
    std::string layout;                  ///< empty: writes the files of `formats`
    DatasetViewOptions view;
    std::optional<std::string> channels;
    RecordingNames names;
    std::vector<std::string> sets;
    std::vector<std::string> only;
    DeviceCommandOptions device;
    std::string point_frame = "sensor";
    std::string crs;
    std::optional<MapProjector> map = {};  ///< of --crs
    std::optional<std::uint64_t> sample;
    std::string weather;
    std::int64_t time_shift_ns = 0;  ///< ScanOutputOptions::time_shift_ns; computed from the run
    bool boxes = false;
    bool deskew = false;
    bool merge = false;
    bool overwrite = false;
    bool no_refine = false;
    bool quiet = false;
    std::optional<OwnVehicle> vehicle = {};         ///< of the rig; empty for that of the log
    std::optional<double> base_link_height_m = {};  ///< computed from the run
    /// Returns true if a camera replaces the sensors.
    bool is_camera() const { return layout.empty() && !view.camera.empty(); }
};

std::vector<std::string> formats_of(const RenderOptions& options) {
    return parse_formats(options.formats.value_or(options.is_camera() ? "png" : "npz"));
}

/// Rejects options that only LiDARs have.
void check_camera(const RenderOptions& options) {
    const bool has_lidar_option = !options.sensor.empty() || options.sample || !options.weather.empty() ||
                                  !options.vehicle_name.empty() || options.merge;
    if (options.is_camera() && has_lidar_option)
        fail<UsageError>(
            "--camera {}: found --sensor, --sample, --weather, --vehicle or --merge, which need a LiDAR; "
            "expected --layout, or none of these",
            options.view.camera);
}

/// Returns how the scans of a sensor are written: formats, frames of reference and names.
/// @param rig_sensor_name empty if there is only one sensor
ScanOutputOptions scan_format(const RenderOptions& options, const Run& run, const SimulatedSensor& sensor,
                              const Pose& sensor_offset, const std::string& rig_sensor_name) {
    ScanOutputOptions format = default_options(run, sensor);
    format.offset = sensor_offset;
    format.time_shift_ns = options.time_shift_ns;
    if (options.vehicle) {
        // --offset is the pose of the rig in the frame of the log's LiDAR. The vehicle's
        // frame is base_link, its reference point in ROS.
        const Pose lidar_from_rig = parse_offset(options.offset);
        format.vehicle = options.vehicle;
        format.vehicle_from_lidar = inverse(lidar_from_rig * options.vehicle->rig_from_base_link);
        format.base_link_height_m = options.base_link_height_m;
    }
    const std::string& log_name = run.log.lidars[std::size_t(sensor.lidar)].name;
    apply_names(format, rig_sensor_name.empty() ? log_name : rig_sensor_name, options.names);
    if (!options.trajectory.file.empty()) format.trajectory = file_name_of(options.trajectory.file);
    format.formats = formats_of(options);
    format.frame = options.map ? PointCoordinateFrame::world : parse_frame(options.point_frame);
    format.map = options.map;
    format.deskew = options.deskew;
    format.only = options.only;
    remove_hidden_boxes(format, run, options.only);
    format.sample = options.sample;
    format.weather = parse_weather(options.weather);
    return format;
}

/// Rejects options that a layout decides itself.
void check_layout(const RenderOptions& options, const MpiProcessGroup& ranks) {
    check_view_options(options.view, options.layout);
    check_camera(options);
    if (options.layout.empty()) return;
    check_dataset_folder(options.out, options.layout);
    if (ranks.size() > 1)
        fail<UsageError>("--layout {}: found {} MPI processes; expected one", options.layout, ranks.size());
    // An option that differs from its default was set by the user.
    if (options.formats || options.merge || options.deskew || options.point_frame != "sensor" ||
        !options.crs.empty())
        fail<UsageError>(
            "--layout {}: found --format, --merge, --deskew, --frame or --crs; the layout decides these",
            options.layout);
}

/// Checks all options that do not depend on the run, before the run is loaded, because
/// loading takes a long time.
void check_options(const RenderOptions& options, bool is_rig, const MpiProcessGroup& ranks) {
    const std::vector<std::string> formats = formats_of(options);
    for (const std::string& format : formats)
        if (options.is_camera() && is_recording(format))
            fail<UsageError>(
                "--camera {}: found --format {}, which stores scans of LiDARs; expected png, npz, exr or "
                "points",
                options.view.camera, format);
        else if (ranks.size() > 1 && is_recording(format))
            fail<UsageError>(
                "--format {}: found {} MPI processes; expected one, because all scans are in one file",
                format, ranks.size());
    check_layout(options, ranks);
    check_recording_names(options.names, formats, is_rig && !options.merge);
    check_map_formats(options.crs, formats);
    // Called only for their errors.
    (void)parse_frame(options.point_frame);
    (void)parse_weather(options.weather);
    if (options.merge && std::ranges::count(formats, "pcap") > 0)
        throw UsageError("--merge: found --format pcap; packets hold the scan of a single sensor");
    if (ranks.is_first() && options.layout.empty()) check_scan_folder(options.out, options.overwrite);
    if (options.merge && !is_rig)
        throw UsageError("--merge needs a rig with several sensors, but --sensor names a single sensor");
    check_time_options(options.trajectory, options.frames.has_value());
}

/// Returns the times of the scans on a trajectory, numbered from 0.
std::vector<NumberedScanTime> sweeps_on_path(const Run& run, const RenderOptions& options,
                                             const PoseTrack& sensor_track, int lidar_index) {
    const std::vector<double> times_s =
        scan_times(options.trajectory, sensor_track,
                   1.0 / run.log.lidars[static_cast<std::size_t>(lidar_index)].sweep_period_s());
    note_leaves_log(run, sensor_track, times_s);
    std::vector<NumberedScanTime> sweeps;
    for (const double t : times_s) sweeps.push_back({static_cast<int>(sweeps.size()), t});
    return sweeps;
}

/// Returns the file format of each sensor. Its offset includes its mounting on the rig.
std::vector<ScanOutputOptions> format_per_sensor(const RenderOptions& options, const Run& run,
                                                 const std::vector<RenderedSensor>& targets,
                                                 const Pose& sensor_offset) {
    std::vector<ScanOutputOptions> formats;
    for (const RenderedSensor& target : targets) {
        formats.push_back(
            scan_format(options, run, target.sensor, sensor_offset * target.mounting, target.folder));
        PacketFormatOptions& packets = formats.back().packets;
        // Without a value, the packets are those of the log's sensor.
        if (target.spinning) packets.sensor = target.spinning;
        // The metadata.json of an Ouster sensor names the format of its packets.
        packets.ouster_profile = read_udp_profile(options.sensor);
    }
    return formats;
}

/// Returns the output format of scans that merge all sensors of a rig. Its range limits
/// include the limits of all sensors.
ScanOutputOptions merged_format(const RenderOptions& options, const Run& run,
                                const std::vector<RenderedSensor>& rig_sensors, const Pose& sensor_offset) {
    SimulatedSensor rig = rig_sensors.front().sensor;
    rig.name = std::filesystem::path(options.sensor).stem().string();
    for (const RenderedSensor& mounted : rig_sensors) {
        const SimulatedSensor& sensor = mounted.sensor;
        rig.returns = std::max(rig.returns, sensor.returns);
        rig.limits = {std::min(rig.limits.min_m, sensor.limits.min_m),
                      std::max(rig.limits.max_m, sensor.limits.max_m)};
    }
    return scan_format(options, run, rig, sensor_offset, "");
}

/// A folder per sensor, or one for merged scans. With a folder per sensor, `recordings`
/// has the scans of all sensors.
struct RenderOutputs {
    std::vector<ScanFolderWriter> folders;
    std::optional<ScanRecordingsWriter> recordings;
    std::optional<DatasetSequenceWriter> dataset;  ///< with --layout, instead of all others
};

/// Creates the output of --layout: a new sequence in a data set.
RenderOutputs create_dataset(const RenderOptions& options, const Run& run,
                             const std::vector<RenderedSensor>& rendered_sensors, const Pose& sensor_offset,
                             const DatasetView& view, const std::vector<NumberedScanTime>& sweeps) {
    const auto formats = format_per_sensor(options, run, rendered_sensors, sensor_offset);
    const std::string description =
        options.lidar + describe_inputs({options.sensor, options.trajectory.file});
    std::vector<DatasetSensor> sensors;
    for (std::size_t i = 0; i < formats.size(); ++i)
        sensors.push_back({formats[i], rendered_sensors[i].mounting, description});
    RenderOutputs output;
    output.dataset.emplace(options.out, options.layout, std::move(sensors), times_of(sweeps),
                           options.overwrite, view);
    return output;
}

/// Creates the output folders in the first MPI process. The other processes wait and then
/// open these folders. If each sensor has a folder, files of recording formats contain
/// the scans of all sensors, so they are written next to these folders.
RenderOutputs create_outputs(const RenderOptions& options, const Run& run,
                             const std::vector<RenderedSensor>& rendered_sensors, const Pose& sensor_offset,
                             const MpiProcessGroup& ranks) {
    std::vector<ScanOutputOptions> formats;
    if (options.merge) formats = {merged_format(options, run, rendered_sensors, sensor_offset)};
    else formats = format_per_sensor(options, run, rendered_sensors, sensor_offset);
    std::vector<std::filesystem::path> folders(formats.size(), options.out);

    RenderOutputs output;
    if (!options.merge && !rendered_sensors.front().folder.empty()) {
        for (std::size_t s = 0; s < folders.size(); ++s) folders[s] /= rendered_sensors[s].folder;
        if (ranks.is_first()) {
            // Checks all folders before files of an earlier rendering are removed.
            for (const std::filesystem::path& folder : folders) check_scan_folder(folder, options.overwrite);
            output.recordings.emplace(options.out, formats);
        }
        // The folders of sensors have only the files of single scans.
        for (ScanOutputOptions& format : formats) std::erase_if(format.formats, is_recording);
    }
    // The first process reaches its barrier after it has created the folders.
    if (!ranks.is_first()) ranks.barrier();
    for (std::size_t s = 0; s < formats.size(); ++s)
        output.folders.push_back(ranks.is_first() ? ScanFolderWriter(folders[s], formats[s])
                                                  : ScanFolderWriter::join_folder(folders[s], formats[s]));
    if (ranks.is_first()) ranks.barrier();
    return output;
}

/// Collects the entries of scans.json from all MPI processes, writes them in the first
/// process, and completes the recordings.
void finish_outputs(RenderOutputs& output, const MpiProcessGroup& ranks) {
    if (output.dataset) output.dataset->finish();
    if (output.recordings) output.recordings->finish();
    for (ScanFolderWriter& folder : output.folders) {
        // One text per process, with one line per scan.
        const std::vector<std::string> texts =
            ranks.gather_texts(fmt::format("{}", fmt::join(folder.entries(), "\n")));
        if (!ranks.is_first()) continue;
        std::vector<std::string> entries;
        for (const std::string& lines : texts)
            if (!lines.empty()) std::ranges::copy(split_text(lines, '\n'), std::back_inserter(entries));
        folder.set_entries(std::move(entries));
        folder.finish();
        note_unobserved(folder.entries(), folder.path().string());
    }
}

class SweepRenderer {
public:
    SweepRenderer(ScanRenderer& renderer, const Run& run, const RenderOptions& options,
                  const std::vector<RenderedSensor>& targets, const Pose& offset, const PoseTrack& track,
                  const std::optional<RenderedSensor>& camera)
        : renderer_(renderer),
          run_(run),
          options_(options),
          targets_(targets),
          offset_(offset),
          track_(track),
          camera_(camera) {
        for (const RenderedSensor& target : targets) mountings_.push_back(target.mounting);
    }

    /// Renders and writes the scans of all sensors at one time.
    void render_sweep(const NumberedScanTime& sweep, RenderOutputs& output) {
        std::vector<RenderedScan> scans;
        for (const RenderedSensor& target : targets_) {
            scans.push_back(render(target.sensor, target.mounting, sweep.time_s, options_.sample));
            RenderedScan& scan = scans.back();
            trace_ms_ += scan.trace_ms;
            n_rays_ += double(scan.image.range_m.size());
            scan.unseen_sides = find_unseen_sides(scan, run_.scene, run_.log);
            for (std::size_t i = 0; i < scan.image.range_m.size(); ++i)
                n_returns_ += is_ray_returned(scan.image.drop_prob[i], scan.image.range_m[i]);
            if (scan.unseen_share) {
                has_unseen_share_ = true;
                n_unseen_ += *scan.unseen_share * double(scan.image.range_m.size());
            }
        }
        if (output.dataset) {
            const std::optional<RenderedScan> picture = render_picture(sweep.time_s);
            return output.dataset->write_scans(scans, picture ? &*picture : nullptr);
        }
        if (options_.merge) scans = {merge_scans(scans, mountings_)};
        for (std::size_t s = 0; s < scans.size(); ++s) output.folders[s].write_scan(sweep.number, scans[s]);
        if (output.recordings) output.recordings->write_scans(scans);
    }
    std::string format_summary(std::size_t n_local, std::size_t n_total, int n_processes) const {
        // All means are over the scans of this process. 1000 rays/ms are 1 Mrays/s.
        const double n_scans = double(n_local);
        return fmt::format(
            "wrote {} scans of {:.0f} rays in {} ({}): {:.1f} % of the rays return{}; tracing took {:.1f} ms "
            "per scan, {:.3f} Mrays/s{}\n",
            n_total, n_rays_ / n_scans, options_.out,
            options_.layout.empty() ? fmt::format("{}", fmt::join(formats_of(options_), ", "))
                                    : options_.layout,
            100.0 * n_returns_ / n_rays_,
            has_unseen_share_
                ? fmt::format(", {:.1f} % of the rays cross space that the log has not observed",
                              100.0 * n_unseen_ / n_rays_)
                : "",
            trace_ms_ / n_scans, trace_ms_ > 0.0 ? 1e-3 * n_rays_ / trace_ms_ : 0.0,
            n_processes > 1 ? fmt::format(" in the first of {} processes", n_processes) : "");
    }

private:
    ScanRenderer& renderer_;
    const Run& run_;
    const RenderOptions& options_;
    const std::vector<RenderedSensor>& targets_;
    const Pose offset_;
    const PoseTrack track_;
    const std::optional<RenderedSensor> camera_;  ///< of a data set with pictures
    std::vector<Pose> mountings_;
    double trace_ms_ = 0.0, n_rays_ = 0.0, n_returns_ = 0.0, n_unseen_ = 0.0;
    bool has_unseen_share_ = false;

    RenderedScan render(const SimulatedSensor& sensor, const Pose& mounting, double time_s, SampleSeed seed) {
        check_interrupt();
        const bool has_user_trajectory = !options_.trajectory.file.empty();
        return has_user_trajectory ? renderer_.render(sensor, {time_s, mount_track(track_, mounting)}, seed)
                                   : renderer_.render(sensor, time_s, offset_ * mounting, seed);
    }
    std::optional<RenderedScan> render_picture(double time_s) {
        if (!camera_) return {};
        // A picture has no weather, and boxes need only the rays of LiDARs.
        renderer_.set_weather({});
        renderer_.count_actor_rays(false);
        RenderedScan picture = render(camera_->sensor, camera_->mounting, time_s, {});
        renderer_.set_weather(parse_weather(options_.weather));
        renderer_.count_actor_rays();
        return picture;
    }
};

/// Selects what the renderer shows and which additional values the output needs.
void configure_renderer(ScanRenderer& renderer, const RenderOptions& options,
                        const std::vector<bool>& shown_instances) {
    const bool has_layout = !options.layout.empty();
    if (!options.only.empty()) renderer.show_instances(shown_instances);
    if (options.boxes || has_layout) renderer.count_actor_rays();
    if (has_layout) renderer.add_channels("class");
    renderer.set_weather(parse_weather(options.weather));
}

/// Prints what the user may not expect of these scans.
void print_render_notes(const RenderOptions& options, const Run& run, const ScanRenderer& renderer,
                        const std::vector<RenderedSensor>& sensors, int lidar) {
    if (std::ranges::any_of(formats_of(options), is_recording))
        note_time_shift(run.log, options.time_shift_ns);
    if (options.sample) note_missing_noise(run, lidar);
    const bool is_in_world = parse_frame(options.point_frame) == PointCoordinateFrame::world;
    if (is_in_world && !options.map) note_local_las(run.log, formats_of(options));
    note_weather(parse_weather(options.weather));
    for (const RenderedSensor& target : sensors) note_sensor(run, renderer, target.sensor);
}

/// Renders scans of a run and writes them. Each MPI process renders a part of them.
void run_render(const RenderOptions& command_options) {
    const MpiProcessGroup ranks;
    RenderOptions options = command_options;
    options.quiet = options.quiet || !ranks.is_first();
    options.device = ranks.select_device(options.device);
    const SensorRig rig = read_sensor_rig(options.sensor);
    options.vehicle = read_rig_vehicle(options.sensor);
    const bool uses_log_vehicle =
        !options.vehicle_name.empty() || (options.vehicle && options.vehicle->is_of_log);
    if (options.vehicle && options.vehicle->is_of_log) options.vehicle.reset();
    check_options(options, rig.has_value(), ranks);
    const Pose offset = parse_offset(options.offset);
    std::optional<LockedFolder> folder;
    // The lock removes a folder that stays empty.
    if (ranks.is_first()) folder.emplace(options.out);
    check_settings_used(options.sets, render_settings(), "render");
    const Run run = load_configured_run(options.run, options.sets, options.channels, options.no_refine);

    const bool has_user_path = !options.trajectory.file.empty();
    const PoseTrack user_path =
        has_user_path ? mount_track(read_trajectory(options.trajectory.file, run.log.georeference), offset)
                      : PoseTrack{};
    const int lidar = find_lidar(run.log, options.lidar);
    const auto sweeps = has_user_path ? sweeps_on_path(run, options, user_path, lidar)
                                      : sweeps_of_frames(run, options.frames, lidar, options.quiet);
    std::vector<RenderedSensor> sensors = options.is_camera() ? list_cameras(options.view.camera, run, lidar)
                                                              : list_sensors(options.sensor, rig, run, lidar);
    if (uses_log_vehicle) add_log_body(sensors, run, lidar, offset);
    options.map = open_map(run.log, options.crs);
    options.time_shift_ns = largest_time_shift_ns(run, sensors, sweeps);
    if (options.vehicle) {
        const PoseTrack log_path = shift_track(run.log.lidar_track(lidar), run.log.world_offset_m);
        const PoseTrack path = has_user_path ? user_path : mount_track(log_path, offset);
        options.base_link_height_m =
            median_height_m(run, path, options.vehicle->rig_from_base_link, times_of(sweeps));
    }
    const std::vector<bool> shown = select_instances(run.scene, options.only);

    Device device(to_device_options(options.device));
    ScanRenderer renderer(device, run);
    configure_renderer(renderer, options, shown);
    const DatasetView view =
        options.layout.empty() ? DatasetView{} : choose_view(options.view, options.layout, run.log, lidar);
    RenderOutputs output = options.layout.empty()
                               ? create_outputs(options, run, sensors, offset, ranks)
                               : create_dataset(options, run, sensors, offset, view, sweeps);
    note_labelled_sector(view);
    std::optional<RenderedSensor> camera;
    if (view.has_pictures)
        camera = {.sensor = camera_sensor(*view.camera, run.config, run.log, lidar),
                  .mounting = view.camera->rig_from_camera};
    print_render_notes(options, run, renderer, sensors, lidar);
    install_handlers();
    TerminalProgress progress(options.quiet);
    SweepRenderer sweep_renderer(renderer, run, options, sensors, offset, subdivide_turns(user_path), camera);
    const ProcessGroup::PartRange share = ranks.group().part_range(sweeps.size());
    for (std::size_t i = share.begin; i < share.end; ++i) {
        sweep_renderer.render_sweep(sweeps[i], output);
        const char* unit = has_user_path ? "scan" : "frame";
        progress.show_step(fmt::format("rendering {} {}:", unit, sweeps[i].number), i + 1 - share.begin,
                           share.end - share.begin);
    }
    end_progress();
    finish_outputs(output, ranks);

    if (options.quiet) return;
    print(sweep_renderer.format_summary(share.end - share.begin, sweeps.size(), ranks.size()));
    const std::optional<double>& height_m = options.base_link_height_m;
    if (options.vehicle)
        print(fmt::format("base_link is {} above the ground\n",
                          height_m ? fmt::format("{:.2f} m", *height_m) : "an unknown height"));
}

/// Adds the options that select the files to write and their content.
void add_file_options(CLI::App& command, RenderOptions& options) {
    add_option(command, "--format LIST", options.formats,
               fmt::format("{}, separated by commas (default: npz, or png of a camera)",
                           fmt::join(scan_formats(), ", ")));
    add_option(command, "--layout NAME", options.layout,
               fmt::format("add the scans and the boxes of all visible objects as a sequence to the data set "
                           "in DIR: {}; instead of --format",
                           fmt::join(list_layouts(), ", ")));
    add_view_options(command, options.view);
    add_option(command, "--frame WHAT", options.point_frame,
               "frame of reference of points: sensor, each point at its own firing time; or world, the "
               "dataset's (default: sensor)");
    add_option(command, "--crs EPSG:N", options.crs,
               "coordinates of this map in las, ply and pcd, for example EPSG:32632; needs a georeference");
    add_channels_option(command, options.channels);
    command.add_flag(
        "--boxes", options.boxes,
        "add the boxes of actors and of labelled standing objects to scans.json, with class, points and "
        "visible share (see below), also of hidden objects; traces the rays near each actor a second time");
    command.add_flag("--deskew", options.deskew,
                     "transform all points of a scan to the sensor frame at the time of the scan (in mcap "
                     "and rosbag: of its stamp), as in a motion-compensated log");
    add_name_options(command, options.names);
    command.add_flag("--merge", options.merge,
                     "merge the scans of a rig's sensors into one scan in the frame of the rig (default: a "
                     "folder for each sensor)");
    command.add_flag("--force", options.overwrite, "replace the rendered scans in DIR");
}

}  // namespace

/// Adds the command `relidar render` and its options to the parser.
void add_render(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("render", "render scans of a trained run");
    const auto options = std::make_shared<RenderOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train`")->required();
    add_option(*command, "--out DIR", options->out, "folder for the scans")->required();
    add_option(*command, "--frames WHICH", options->frames,
               "first:end by the dataset's frame numbers, or test, train or all (default: test, or all if "
               "none is held out)");
    add_option(*command, "--offset X,Y,Z,YAW_DEG", options->offset,
               "shift the sensor in its own frame: forward, left, up in metres, turn left in degrees");
    add_path_options(*command, options->trajectory);
    add_option(*command, "--lidar NAME", options->lidar,
               "LiDAR of the log whose frames and mounting are used, by its name in `relidar info` (default: "
               "the first)");
    add_option(*command, "--sensor NAME|FILE", options->sensor,
               "another sensor: native (the log's), one of `relidar list sensors`, or the file of a sensor "
               "or rig (see below)");
    add_option(*command, "--vehicle log", options->vehicle_name,
               "also block another sensor where the vehicle or person that carried the log's LiDAR blocks "
               "that LiDAR; for sensors at about the same place")
        ->check([](const std::string& text) {
            return text == kVehicleOfLog ? "" : fmt::format("found {}, expected log", text);
        });
    add_list_option(*command, "--only WHAT", options->only,
                    "render only this part: background, actors, or a track; repeatable");
    add_option(*command, "--sample SEED", options->sample,
               "draw random scans with this seed: drops by their probability, ranges and intensities with "
               "the noise of the log (default: the most likely scan, without noise)")
        ->check([](const std::string& text) {
            // An empty text means that the value is valid.
            std::uint64_t seed = 0;
            const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), seed);
            const bool is_valid = error == std::errc() && *end == '\0';
            return is_valid ? "" : fmt::format("found {}, expected an integer from 0 to 2^64 - 1", text);
        });
    add_weather_option(*command, options->weather,
                       "all scans; the random seed is the value of --sample, or 0 without it");
    add_file_options(*command, *options);
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    add_no_refine_option(*command, options->no_refine);
    add_quiet_option(*command, options->quiet);
    command->footer(render_output_help() + render_channels_help() + sensor_file_help() +
                    "\n"
                    "Examples:\n"
                    "  relidar render run --out scans\n"
                    "  relidar render run --out pictures --camera kitti\n"
                    "  relidar render run --out lane --trajectory trajectory.csv --rate 20 --format pcd\n"
                    "  relidar render run --out fog --weather fog=50 --sample 1 --format ply\n"
                    "  mpirun -n 8 relidar render run --out scans --frames all");
    run_after_parsing(*command, call, options, run_render);
}

}  // namespace relidar::cli
