// SPDX-License-Identifier: Apache-2.0
#include "run.hpp"

#include <algorithm>
#include <cmath>
#include <variant>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <relidar/diff/rays.h>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/actor_boxes.hpp>
#include <relidar/simulate/camera.hpp>
#include <relidar/simulate/device_points.hpp>
#include <relidar/train/train.hpp>
#include "arrays.hpp"
#include "base/fail.hpp"
#include "conversions.hpp"
#include "device_array.hpp"
#include "integers.hpp"
#include "log.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

struct RenderArguments {
    py::object sensor, pose;
    std::optional<double> time;
    std::optional<py::dict> actors;
    std::string lidar;
    std::vector<std::string> only{};
    std::optional<std::uint64_t> sample{};
    std::string frame{};
    bool deskew = false;
    std::string weather{};
    bool boxes = false;
    py::object camera = py::none();
};

/// Checks that a track has poses around a time. At other times, the poses would be
/// extrapolated.
/// @throws UsageError if the time is more than `tolerance_s` before or after the track
void check_time(const PoseTrack& track, double time_s, double tolerance_s, const std::string& where) {
    // Accepts all times if the track has only one pose, because this pose is valid at all
    // times. Also accepts times that are not finite, because the renderer reports them.
    if (track.pose.size() < 2 || !std::isfinite(time_s)) return;
    const double begin_s = track.time_s.front() - tolerance_s, end_s = track.time_s.back() + tolerance_s;
    if (time_s < begin_s || time_s > end_s)
        fail<UsageError>("{}: found {} s, expected a time from {} to {} s", where, time_s, begin_s, end_s);
}

/// Converts the argument `actors` of render(): a dict of actor -> pose or (times, poses).
/// @param scan_time_s  time of the scan
ActorTracksByName to_tracks(const py::dict& poses_by_actor, double scan_time_s) {
    // An actor may be rendered this long before its first pose or after its last pose. A
    // sweep begins before its nominal time and ends after it, so the limit is not 0.
    constexpr double kTimeMargin_s = 1.0;
    ActorTracksByName poses;
    for (const auto& [name, pose] : poses_by_actor) {
        const std::string actor = py::str(name);
        const std::string where = fmt::format("actors[\"{}\"]", actor);
        poses[actor] = to_track(pose, where, scan_time_s);
        check_time(poses[actor], scan_time_s, kTimeMargin_s,
                   fmt::format("the scan time does not match the poses of {}", where));
    }
    return poses;
}

int find_nearest_frame(const Log& log, double time_s) {
    const auto distance_s = [&](const Frame& frame) { return std::abs(frame.time_s - time_s); };
    return std::ranges::min_element(log.frames, {}, distance_s)->index;
}

/// Returns the request for a scan. Without a pose, the sensor follows the log's path.
ScanRequest make_request(const RenderArguments& arguments, const Run& run, int lidar) {
    const Log& log = run.log;
    const bool follows_log = arguments.pose.is_none();
    ScanRequest request;
    request.time_s = arguments.time.value_or(log.frames.front().time_s);
    // The world frame of the log is the dataset's, shifted by world_offset_m.
    if (follows_log) request.dataset_from_sensor = shift_track(log.lidar_track(lidar), log.world_offset_m);
    else request.dataset_from_sensor = to_track(arguments.pose, "pose", request.time_s);
    check_time(request.dataset_from_sensor, request.time_s, /*margin_s=*/0.0,
               follows_log ? "time in the log" : "time on the poses");
    if (arguments.actors) request.dataset_from_actor = to_tracks(*arguments.actors, request.time_s);
    return request;
}

/// Returns the request for a scan and its sensor. Without a pose, the sensor also has the
/// head angles of the log's sweep.
std::pair<ScanRequest, SimulatedSensor> prepare_scan(const RenderArguments& arguments, const Run& run) {
    const int lidar = find_lidar(run.log, arguments.lidar);
    ScanRequest request = make_request(arguments, run, lidar);
    if (!arguments.camera.is_none()) {
        if (!arguments.sensor.is_none())
            throw UsageError("render: found a sensor and a camera, expected one of them");
        const Camera camera = camera_for_run(arguments.camera, run, lidar);
        request.dataset_from_sensor =
            mount_track(subdivide_turns(request.dataset_from_sensor), camera.rig_from_camera);
        return {request, camera_sensor(camera, run.config, run.log, lidar)};
    }
    SimulatedSensor sensor = sensor_for_run(arguments.sensor, run, lidar);
    if (arguments.pose.is_none())
        sensor = follow_sweep(sensor, run.log.frames, run.log.lidars, request.time_s);
    return {request, sensor};
}

/// Returns the boxes of a scan as arrays with one row per box.
py::dict actor_boxes_dict(const RenderedScan& scan, const ScanOutputOptions& options) {
    const std::vector<ActorBox> boxes = actor_boxes_of(scan, options);
    std::vector<std::string> tracks, classes, labels, notes;
    std::vector<double> sizes_m, times_s, poses, velocities_mps, shares;
    std::vector<std::int32_t> points, is_static, is_discovered;
    const auto append = [](std::vector<double>& values, const glm::dvec3& vector) {
        values.insert(values.end(), {vector.x, vector.y, vector.z});
    };
    for (const ActorBox& box : boxes) {
        tracks.push_back(box.track);
        classes.push_back(name_of(box.object_class));
        labels.push_back(box.label);
        notes.emplace_back(name_of(box.note));
        is_static.push_back(box.is_static);
        is_discovered.push_back(box.is_discovered);
        append(sizes_m, box.size_m);
        append(velocities_mps, box.velocity_mps);
        times_s.push_back(box.time_s);
        shares.push_back(box.visible_share);
        points.push_back(std::int32_t(box.n_points));
        append_pose(poses, box.dataset_from_box);
    }
    const std::size_t n = boxes.size();
    return to_array_dict({make_text_array("track", tracks), make_text_array("class", classes),
                          make_text_array("label", labels), make_text_array("note", notes),
                          make_array("is_static", {n}, is_static.data(), n),
                          make_array("is_discovered", {n}, is_discovered.data(), n),
                          make_array("size_m", {n, 3}, sizes_m.data(), sizes_m.size()),
                          make_array("time_s", {n}, times_s.data(), n),
                          make_array("pose", {n, 4, 4}, poses.data(), poses.size()),
                          make_array("velocity_mps", {n, 3}, velocities_mps.data(), velocities_mps.size()),
                          make_array("points", {n}, points.data(), n),
                          make_array("visible_share", {n}, shares.data(), n)});
}

/// Adds the spawned actors to the names and boxes of a scan.
void add_spawned(const std::vector<SpawnedActor>& actors, ScanOutputOptions& format) {
    for (const auto& [handle, name, category, size_m] : actors) {
        const auto instance = std::size_t(handle);
        if (format.instance_names.size() <= instance) format.instance_names.resize(instance + 1);
        format.instance_names[instance] = name;
        format.actors.push_back({.id = name, .category = category, .size_m = size_m, .world_from_box = {}});
    }
}

PointCoordinateFrame parse_point_frame(const std::string& text) {
    if (text == "sensor") return PointCoordinateFrame::sensor;
    if (text == "world") return PointCoordinateFrame::world;
    fail<UsageError>("argument frame: found \"{}\", expected sensor or world", text);
}

/// Renders a scan and returns its arrays. Checks all arguments before it locks the
/// device, so that an error does not block other threads.
py::dict render_scan(LoadedRun& loaded, const RenderArguments& arguments) {
    const Run& run = loaded.run;
    const auto [request, sensor] = prepare_scan(arguments, run);
    const std::vector<bool> shown = arguments.only.empty()
                                        ? std::vector<bool>(run.scene.instances.size(), true)
                                        : select_instances(run.scene, arguments.only);
    ScanOutputOptions format = default_options(run, sensor);
    format.frame = parse_point_frame(arguments.frame);
    format.deskew = arguments.deskew;
    const Weather weather = parse_weather(arguments.weather);
    const RenderedScan scan = loaded.get_renderer().use([&](ScanRenderer& renderer) {
        renderer.show_instances(shown);
        renderer.set_weather(weather);
        renderer.count_actor_rays(arguments.boxes);
        add_spawned(renderer.spawned(), format);  // Only the renderer has spawned actors.
        return renderer.render(sensor, request, arguments.sample);
    });
    py::dict arrays = to_array_dict(scan_arrays(scan, find_nearest_frame(run.log, request.time_s), format));
    if (!arguments.boxes) return arrays;
    // Actors with poses in the request were not rendered where the log has them.
    if (request.dataset_from_actor) move_actor_boxes(format, *request.dataset_from_actor);
    arrays["boxes"] = actor_boxes_dict(scan, format);
    return arrays;
}

/// Renders the points of a scan, which stay on the device. All actors are visible and the
/// weather is clear, whatever an earlier render_scan() has set.
py::dict render_points(LoadedRun& loaded, const RenderArguments& arguments) {
    const Run& run = loaded.run;
    const auto [request, sensor] = prepare_scan(arguments, run);
    const DevicePoints points = loaded.get_renderer().use([&](ScanRenderer& renderer) {
        renderer.show_instances(std::vector<bool>(run.scene.instances.size(), true));
        renderer.set_weather({});
        renderer.submit_points(sensor, request, request.time_s, arguments.sample,
                               ScanRenderer::SubmissionTiming::now, ScanRenderer::PointMemory::device);
        return renderer.wait_for_device_points();
    });
    using shared::ReturnedPoint;
    const auto wrap = [&](auto member) {
        return wrap_member(loaded.device, points.points, member, points.n_points);
    };
    py::dict arrays;
    arrays["position"] = wrap(&ReturnedPoint::position);
    arrays["intensity"] = wrap(&ReturnedPoint::intensity);
    arrays["time"] = wrap(&ReturnedPoint::time_offset_s);
    arrays["ring"] = wrap(&ReturnedPoint::ring);
    arrays["instance"] = wrap(&ReturnedPoint::instance);
    arrays["pose"] = pose_matrix(points.dataset_from_points);
    return arrays;
}

/// Returns the rays of a frame and their measured values, as training uses them.
py::dict training_rays_dict(const LoadedRun& loaded, const LoadedLog& recorded,
                            IntegerArgument<std::uint32_t, "position"> position) {
    const Run& run = loaded.run;
    const std::vector<Frame>&run_frames = run.log.frames, &log_frames = recorded.log.frames;
    if (position >= run_frames.size() || position >= log_frames.size() ||
        run_frames[position].index != log_frames[position].index)
        fail<UsageError>(
            "cannot use frame {}: found a log of {} frames and a run of {} frames, expected the same frames "
            "in both",
            position.value, log_frames.size(), run_frames.size());
    // The run has the registered poses, but no scans.
    Frame frame = run_frames[position];
    frame.scan = log_frames[position].scan;
    TrainingRays training = make_training_rays(run, frame);
    const auto n = static_cast<py::ssize_t>(training.rays.size());
    constexpr py::ssize_t kRayNumbers = sizeof(shared::DeviceRay) / sizeof(float),
                          kTargetNumbers = sizeof(shared::DeviceTarget) / sizeof(float);
    py::dict dict;
    dict["rays"] = move_to_numpy<float>(std::move(training.rays), {n, kRayNumbers});
    dict["measured"] = move_to_numpy<float>(std::move(training.targets), {n, kTargetNumbers});
    // Position of the sensor in the scene at the time of the frame.
    const Pose& mounting = run.log.lidar_of(frame).vehicle_from_sensor;
    const glm::dvec3 sensor_m =
        run.log.world_from_vehicle.mounted_pose_at(frame.time_s, mounting).translation;
    dict["view_origin"] = move_to_numpy<double>(std::vector{sensor_m.x, sensor_m.y, sensor_m.z}, {3});
    dict["shape"] = py::make_tuple(frame.scan.rays.rows, frame.scan.rays.columns);
    return dict;
}

void spawn_actor(LoadedRun& run, const std::variant<std::string, LoadedRun*>& actor,
                 const std::string& name) {
    run.get_renderer().use([&](ScanRenderer& renderer) {
        if (const auto* track = std::get_if<std::string>(&actor)) renderer.spawn(*track, name);
        else renderer.spawn(std::get<LoadedRun*>(actor)->run, name);
    });
}

void despawn_actor(LoadedRun& run, const std::string& name) {
    run.get_renderer().use([&](ScanRenderer& renderer) { renderer.despawn(name); });
}

/// Returns a copy of a run with other surfels, of the same number and primitive.
std::unique_ptr<LoadedRun> replace_surfels(const LoadedRun& loaded, const py::dict& arrays) {
    auto changed = std::make_unique<LoadedRun>(loaded.run, loaded.device);
    Surfels surfels = read_surfels(arrays);
    Scene& scene = changed->run.scene;
    // The new surfels replace those of all blocks.
    scene = with_all_blocks(scene);
    if (surfels.size() != scene.surfels.size() || surfels.primitive != scene.surfels.primitive)
        fail("with_surfels: found {} {}, expected {} {}, the same number and kind as in the run",
             surfels.size(), properties_of(surfels.primitive).label, scene.surfels.size(),
             properties_of(scene.surfels.primitive).label);
    scene.surfels = std::move(surfels);
    return changed;
}

constexpr const char* kHelpBeforeWeather =
    "Renders a scan.\n\n"
    "sensor: one of relidar.sensors(), \"native\" (the sensor of the log), \"kitti360\", a CSV beam table, "
    "or a dict of rays like that of relidar.rays(); None: the sensor in the settings of the run\n"
    "pose: sensor to the dataset's world, [4,4] float64, metres; or (times [n], poses [n,4,4]) that also "
    "cover the sweep, so that each ray is fired\n"
    "    from the position of the sensor at its firing time; None: the pose of the log's sensor\n"
    "camera: instead of a sensor: a camera of the log by its name, \"kitti\", \"nuscenes\", a JSON file, or "
    "a dict with the keys of this file; it is mounted on the\n"
    "    sensor of `pose`\n"
    "time: time of the log in seconds at which the head faces forward, within the times of the poses; None: "
    "the time of the first frame.\n"
    "    Without `pose`, at the time of a frame, the log's sensor has the same head angles as in that sweep\n"
    "actors: dict of track -> pose of the centre of its box, in the form of `pose`, at times up to a second "
    "from `time`; other actors are absent.\n"
    "    None: all actors at the poses of their tracks\n"
    "lidar: name of the LiDAR of the log that is simulated or replaced; empty: the first\n"
    "only: render only these parts: \"background\", \"actors\" or tracks\n"
    "sample: seed for random drops and noise with the statistics of the log; None: the most likely scan, "
    "without noise\n"
    "frame: frame of origin and directions: \"sensor\" (at the firing time of each ray) or \"world\" (the "
    "dataset's)\n"
    "deskew: use the sensor frame at `time` for all rays. This has no effect without a rolling shutter, for "
    "example if the log is\n"
    "    motion-compensated: then `time` is 0 for all rays and `deskewed` is 1\n"
    "weather: text; ";
constexpr const char* kHelpAfterWeather =
    "\n\n"
    "Returns the same arrays as an npz file of `relidar render`: range, median_range (metres), intensity, "
    "drop_prob, weight, time (seconds\n"
    "from `time`) [rows,columns] float32; ring uint16, instance int32 (-1: no hit) [rows,columns]; "
    "directions, origin, points (the ends of the rays)\n"
    "[rows,columns,3] float32 (origin and points of the world: float64); pose [4,4] float64; time_s, "
    "frame_number (of the log's sweep nearest in time), instance_names, frame,\n"
    "deskewed, sensor, run, units; each channel of render.channels by its name, [rows,columns] or\n"
    "[rows,columns,3]; unseen, the share of rays that cross space that the log has not observed, if the run "
    "has this information and the scan shows the background.\n"
    "With `boxes`, also the dict boxes of the n actors and standing objects that a ray would hit, each at "
    "the time at which the sensor faces it: track,\n"
    "class (Car, Van, Truck, Bus, Trailer, Cyclist, Motorcycle, Pedestrian, Other), label (the class in the "
    "dataset) and note (\"\", \"covered\", \"not_observed\") [n]\n"
    "str, is_static (1: part of the background) and is_discovered (1: moves and has no label) [n] int32,\n"
    "size_m [n,3], time_s [n], pose of the centre [n,4,4], velocity_mps [n,3] float64, points (first returns "
    "on it) [n] int32, visible_share [n].\n\n"
    "With a camera, also picture uint8, depth uint16 (metres * 256, 0: no return) [rows,columns], and K "
    "[3,3]; the frame of the sensor is x right, y down, z forward.\n\n"
    "Raises DataError for arrays of wrong shape, dtype or order and poses that are not rigid, UsageError for "
    "unknown names and weather.";

void bind_methods(py::class_<LoadedRun>& run_class) {
    const std::string render_help = fmt::format(
        "{}{}.\n    The seed of the weather is `sample`, or 0 if `sample` is None. Weather adds the array "
        "`source` [rows,columns] int32: {}{}",
        kHelpBeforeWeather, weather_help(), parse_channels("source").front().meaning, kHelpAfterWeather);
    run_class
        .def_static(
            "load", &load_run_with, py::arg("folder"), py::kw_only(), py::arg("settings") = py::dict(),
            py::arg("device") = py::none(),
            "Reads a run folder.\n\n"
            "settings: dict of settings that replace those of the run, such as {\"render.range\": "
            "\"median\"}\n"
            "device: device for rendering; None: the default device\n\n"
            "Raises DataError with the name of the file that is missing, damaged or of another format.")
        .def("save", &save_run_in, py::arg("folder"), py::kw_only(), py::arg("overwrite") = false,
             "Writes config.toml, scene.json and model.safetensors. Incomplete files are never left behind. "
             "Raises UsageError if the folder already contains a run.")
        .def(
            "render",
            [](LoadedRun& run, const py::object& sensor, const py::object& pose, std::optional<double> time,
               std::optional<py::dict> actors, std::string lidar, std::vector<std::string> only,
               std::optional<IntegerArgument<std::uint64_t, "sample">> sample, std::string frame, bool deskew,
               std::string weather, bool boxes, const py::object& camera) {
                return render_scan(
                    run, {sensor, pose, time, std::move(actors), std::move(lidar), std::move(only), sample,
                          std::move(frame), deskew, std::move(weather), boxes, camera});
            },
            py::arg("sensor") = py::none(), py::kw_only(), py::arg("pose") = py::none(),
            py::arg("time") = py::none(), py::arg("actors") = py::none(), py::arg("lidar") = "",
            py::arg("only") = std::vector<std::string>(), py::arg("sample") = py::none(),
            py::arg("frame") = "sensor", py::arg("deskew") = false, py::arg("weather") = "",
            py::arg("boxes") = false, py::arg("camera") = py::none(), render_help.c_str())
        .def(
            "points",
            [](LoadedRun& run, const py::object& sensor, const py::object& pose, std::optional<double> time,
               std::optional<py::dict> actors, std::string lidar,
               std::optional<IntegerArgument<std::uint64_t, "sample">> sample) {
                return render_points(run,
                                     {sensor, pose, time, std::move(actors), std::move(lidar), {}, sample});
            },
            py::arg("sensor") = py::none(), py::kw_only(), py::arg("pose") = py::none(),
            py::arg("time") = py::none(), py::arg("actors") = py::none(), py::arg("lidar") = "",
            py::arg("sample") = py::none(),
            "Renders the points of a scan, which stay in the memory of the device. The arguments accept the "
            "same values as in render(). Without `sample`, the host only reads the number of points.\n\n"
            "Returns a dict of DeviceArray: position [n,3], intensity, time (seconds from `time`) [n] "
            "float32, ring, instance [n] int32; pose [4,4] float64 of the sensor at `time`, in whose frame "
            "the points are. Intensities are not rounded to the steps of the log.")
        .def(
            "rays",
            [](const LoadedRun& run, const py::object& sensor, const std::string& lidar) {
                SimulatedSensor choice = sensor_for_run(sensor, run.run, find_lidar(run.run.log, lidar));
                if (!is_rolling(choice, run.run.config)) std::ranges::fill(choice.rays.time_offset_s, 0.0f);
                return to_array_dict(choice.rays);
            },
            py::arg("sensor") = py::none(), py::arg("lidar") = "",
            "Returns the rays of a sensor. The arguments accept the same values as in render().")
        .def("training_rays", &training_rays_dict, py::arg("log"), py::arg("position"),
             "Returns a scan as training uses it, in the frame of the scene.\n\n"
             "log: the log of the run\n"
             "position: of the frame in `times`\n\n"
             "Returns a dict: rays [n,7] float32 (origin, direction, seconds from the time of the frame), "
             "measured [n,3] float32 (range in metres,\n"
             "    0: dropped; intensity; weight, 0: ignored), view_origin [3] float64 (of the sensor), shape "
             "(rows, columns).")
        .def("spawn", &spawn_actor, py::arg("actor").none(false), py::arg("name"),
             "Adds an actor to the scene of the following scans, without loading the scene again. Only scans "
             "that name it in `actors` show it.\n\n"
             "actor: a track of this run, a spawned actor, or another run with a single actor, for example "
             "an asset\n"
             "name: a name that no other actor has\n\n"
             "Raises UsageError for an unknown actor or a name in use, and DataError if the surfels have "
             "another primitive.")
        .def("despawn", &despawn_actor, py::arg("name"),
             "Removes a spawned actor. Raises UsageError if there is none with this name.")
        .def(py::pickle(&pickle_run, &unpickle_run))
        .def("with_surfels", &replace_surfels, py::arg("surfels"),
             "Returns a copy of the run with other values of all surfels. Raises DataError if the number of "
             "surfels differs.");
}

void bind_properties(py::class_<LoadedRun>& run_class) {
    bind_log_properties(run_class, [](const LoadedRun& run) -> const Log& { return run.run.log; });
    run_class
        .def_property_readonly(
            "folder", [](const LoadedRun& run) { return run.run.folder.string(); },
            "Folder that the run was read from or saved to. Empty if there is none.")
        .def_property_readonly(
            "config", [](const LoadedRun& run) { return run.run.config; }, "A copy of the settings.")
        .def_property_readonly(
            "scene",
            [](const LoadedRun& run) { return std::make_shared<Scene>(with_all_blocks(run.run.scene)); },
            "A copy of the scene.")
        .def_property_readonly(
            "surfels",
            [](const LoadedRun& run) { return to_array_dict(with_all_blocks(run.run.scene).surfels); },
            "A copy of the surfels as a dict of float32 arrays that relidar.Scene accepts.")
        .def_property_readonly(
            "held_out", [](const LoadedRun& run) { return run.run.split.test; },
            "Indices of the held-out frames in `times`.")
        .def_property_readonly(
            "actors",
            [](const LoadedRun& run) { return track_dict(run.run.log, actor_names(run.run.scene)); },
            "Trajectories of the actors in the dataset's world: dict of track -> (times [n], poses [n,4,4]) "
            "of the centre of the box, in the form of render().")
        .def_property_readonly(
            "categories",
            [](const LoadedRun& run) {
                std::map<std::string, std::string> categories;
                for (const ModelInstance& instance : run.run.scene.instances)
                    if (const BoxTrack* box = find_box(run.run.log, instance.track))
                        categories[box->id] = name_of(class_of(*box));
                return categories;
            },
            "Class names of the actors, as in the boxes of render(): dict of track -> name.")
        .def_property_readonly(
            "edits",
            [](const LoadedRun& run) {
                std::vector<std::string> edits;
                for (const EditHistoryEntry& edit : run.run.edits) edits.push_back(edit.edit);
                return edits;
            },
            "Descriptions of all edits of the run, the oldest edit first.");
}

}  // namespace

/// Returns the renderer of the run, which is created at the first call.
DeviceObject<ScanRenderer>& LoadedRun::get_renderer() {
    if (renderer) return renderer;
    device = device_or_default(device);
    auto fresh = DeviceObject<ScanRenderer>::create(device, run);
    // keeps the renderer if another thread has created one during this call
    if (!renderer) renderer = std::move(fresh);
    return renderer;
}

/// Adds relidar.Run, a trained scene with everything that rendering needs.
void bind_run_class(py::module_& module) {
    py::class_<LoadedRun> type(
        module, "Run",
        "A trained scene with the sensor, poses and tracks of its log, as written by `relidar train`. Its "
        "content does not change. A pickled run has neither its device nor its spawned actors: it uses the "
        "default device of the process that reads it. Its files are part of the pickle only if the run is "
        "not stored in its folder as it is.");
    bind_methods(type);
    bind_properties(type);
}

}  // namespace relidar::python
