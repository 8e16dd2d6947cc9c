// SPDX-License-Identifier: Apache-2.0
#include "log.hpp"

#include <algorithm>

#include <pybind11/stl/filesystem.h>

#include <relidar/read/dataset.hpp>
#include <relidar/run/stage_options.hpp>
#include "arrays.hpp"
#include "calls.hpp"
#include "conversions.hpp"
#include "integers.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

namespace fs = std::filesystem;

/// Reads a log for Python, with its settings. Returns the settings with the path of the
/// log and its maximum range, because a training continues with them.
LoadedLog load_dataset(const std::string& path, const std::optional<Config>& config,
                       const PythonProgressCallback& progress) {
    LoadedLog loaded{.log = {}, .config = config.value_or(make_preset("default"))};
    loaded.config.dataset.path = absolute_dataset(path);
    // Releases the interpreter. The progress callback locks it again for each call.
    const py::gil_scoped_release gil_released;
    constexpr int kMibShift = 20;
    limit_scan_memory(std::uint64_t(loaded.config.dataset.memory_mib) << kMibShift);
    loaded.log = load_log(loaded.config, wrap_progress(progress));
    loaded.config = with_max_range(std::move(loaded.config), loaded.log);
    return loaded;
}

/// Returns the scan of a frame as arrays: its rays, ranges, intensities and classes.
/// @param position  index of the frame in the log
py::dict make_scan_dict(const LoadedLog& loaded, IntegerArgument<int, "position"> position) {
    const std::vector<Frame>& frames = loaded.log.frames;
    if (position < 0 || position >= static_cast<int>(frames.size()))
        throw py::index_error(
            fmt::format("cannot read scan {}: the log has only {} frames", position.value, frames.size()));
    const Scan& scan = frames[static_cast<std::size_t>(position.value)].scan;
    const NumpyShape image_shape{scan.rays.rows, scan.rays.columns};
    RayTable rays = scan.rays;
    // In a motion-compensated log, all points of a frame have the same time.
    if (!loaded.log.rolling_shutter) std::ranges::fill(rays.time_offset_s, 0.0f);
    py::dict dict = to_array_dict(rays);
    dict["range"] = move_to_numpy<float>(to_vector(scan.range_m), image_shape);
    dict["intensity"] = move_to_numpy<float>(to_vector(scan.intensity), image_shape);
    std::vector<std::int32_t> classes;
    for (const SurfaceClass surface : scan.classes) classes.push_back(std::int32_t(surface));
    if (!classes.empty()) dict["class"] = move_to_numpy<std::int32_t>(std::move(classes), image_shape);
    return dict;
}

void save_street(const fs::path& folder, IntegerArgument<std::uint64_t, "seed"> seed,
                 IntegerArgument<int, "n_frames"> n_frames, IntegerArgument<int, "rows"> rows,
                 IntegerArgument<int, "columns"> columns, bool with_people, bool with_gait) {
    StreetOptions options;
    options.seed = seed;
    options.n_frames = n_frames;
    options.rows = rows;
    options.columns = columns;
    options.people = with_people;
    options.gait = with_gait;
    save_street(options, folder);
}

}  // namespace

py::object frame_times(const Log& log) {
    std::vector<double> times;
    for (const Frame& frame : log.frames) times.push_back(frame.time_s);
    return move_to_numpy<double>(std::move(times), {static_cast<py::ssize_t>(log.frames.size())});
}

py::object frame_numbers(const Log& log) {
    std::vector<std::int32_t> numbers;
    for (const Frame& frame : log.frames) numbers.push_back(frame.index);
    return move_to_numpy<std::int32_t>(std::move(numbers), {static_cast<py::ssize_t>(log.frames.size())});
}

py::object vehicle_path(const Log& log) {
    return to_times_and_poses(log.world_from_vehicle, log.world_offset_m);
}

py::object world_offset(const Log& log) {
    const glm::dvec3& offset = log.world_offset_m;
    return move_to_numpy<double>(std::vector{offset.x, offset.y, offset.z}, {3});
}

py::object mounting_dict(const Log& log) {
    py::dict mountings;
    for (const Lidar& lidar : log.lidars)
        mountings[py::str(lidar.name)] = pose_matrix(lidar.vehicle_from_sensor);
    return mountings;
}

py::object track_dict(const Log& log, const std::vector<std::string>& track_names) {
    py::dict actors;
    for (const BoxTrack& box : log.boxes)
        if (std::find(track_names.begin(), track_names.end(), box.id) != track_names.end())
            actors[py::str(box.id)] = to_times_and_poses(box.world_from_box, log.world_offset_m);
    return actors;
}

namespace {

void bind_class(py::module_& module) {
    py::class_<LoadedLog> type(
        module, "Log",
        "A LiDAR log with scans, rays, sensor poses and tracked boxes. load_log() creates it.");
    bind_log_properties(type, [](const LoadedLog& loaded) -> const Log& { return loaded.log; });
    type.def(
            "__len__", [](const LoadedLog& loaded) { return loaded.log.frames.size(); }, "Number of frames.")
        .def_property_readonly("name", [](const LoadedLog& loaded) { return loaded.log.name; })
        .def_property_readonly(
            "notes",
            [](const LoadedLog& loaded) {
                return std::vector<std::string>(loaded.log.notes.begin(), loaded.log.notes.end());
            },
            "Notes about missing data of the log, one line each.")
        .def_property_readonly(
            "conventions",
            [](const LoadedLog& loaded) {
                py::dict rows;
                for (const UsedConvention& used : loaded.log.conventions_used)
                    rows[py::str(used.name)] =
                        py::dict(py::arg("value") = used.value, py::arg("from") = used.from,
                                 py::arg("setting") = used.setting);
                return rows;
            },
            "How the numbers of the log were read: dict of convention -> dict with value, from (why), and "
            "setting, the key of the setting that changes it.")
        .def_property_readonly(
            "config", [](const LoadedLog& loaded) { return loaded.config; },
            "A copy of the settings that the log was read with.")
        .def_property_readonly(
            "frame_lidars",
            [](const LoadedLog& loaded) {
                py::list names;
                for (const Frame& frame : loaded.log.frames) names.append(loaded.log.lidar_of(frame).name);
                return names;
            },
            "Name of the LiDAR of each frame, [frames]. Empty if the log has a single LiDAR.")
        .def_property_readonly(
            "boxes",
            [](const LoadedLog& loaded) {
                std::vector<std::string> track_names;
                for (const BoxTrack& box : loaded.log.boxes) track_names.push_back(box.id);
                return track_dict(loaded.log, track_names);
            },
            "Trajectories of the labelled boxes in the dataset's world: dict of track -> (times [n], poses "
            "[n,4,4]) of the centre of the box.")
        .def(
            "rays",
            [](const LoadedLog& loaded, const std::string& lidar) {
                return to_array_dict(
                    make_rays(loaded.log.lidars[std::size_t(find_lidar(loaded.log, lidar))].sensor));
            },
            py::arg("lidar") = "",
            "Returns the rays of a LiDAR of the log, in the form of relidar.rays(). Empty name: the first "
            "LiDAR.")
        .def("scan", &make_scan_dict, py::arg("position"),
             "Returns the scan of a frame: the arrays of relidar.rays(), range [rows,columns] float32 "
             "(metres along the ray, 0 if dropped) and intensity.\n\n"
             "position: 0 ... len(log) - 1");
}

/// Adds relidar.load_log() and relidar.save_street().
void bind_loading(py::module_& module) {
    module.def(
        "load_log",
        [](const py::object& dataset, const std::optional<Config>& config,
           const PythonProgressCallback& progress) {
            return load_dataset(py::module_::import("os").attr("fspath")(dataset).cast<std::string>(), config,
                                progress);
        },
        py::arg("dataset"), py::arg("config") = py::none(), py::arg("progress") = py::none(),
        "Reads a log.\n\n"
        "dataset: a path whose format is recognised, or \"kind:path\" with kind kitti_raw or synthetic\n"
        "config: its settings dataset.* select frames, poses and ranges; None: preset \"default\"\n"
        "progress: called with the name of a step and its progress from 0 to 1\n\n"
        "Raises DataError with the name of the file and a description of the error.");
    module.def("save_street", &save_street, py::arg("folder"), py::kw_only(), py::arg("seed") = 1,
               py::arg("n_frames") = 30, py::arg("rows") = 32, py::arg("columns") = 512,
               py::arg("people") = false, py::arg("gait") = false,
               "Writes the synthetic street of `relidar demo` as a folder that load_log() reads. "
               "people: add pedestrians and a\n"
               "cyclist. gait: let the pedestrians also swing their legs and arms.");
}

}  // namespace

void bind_log(py::module_& module) {
    bind_class(module);
    bind_loading(module);
}

}  // namespace relidar::python
