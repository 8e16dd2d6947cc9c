// SPDX-License-Identifier: Apache-2.0
#include "conversions.hpp"

#include <cmath>

#include <pybind11/stl.h>

#include <relidar/log/camera.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include "arrays.hpp"
#include "base/fail.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

constexpr float kMaxLengthError =
    1e-3f;  // Largest accepted difference between the length of a direction and 1.

/// Rejects directions of another length than 1, and values that are not finite.
void check_rays(const RayTable& rays) {
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const float length = glm::length(rays.direction[i]);
        // The negated comparison also rejects NaN.
        if (!(std::abs(length - 1.0f) <= kMaxLengthError))
            fail("sensor: directions: found length {} at ray {}, expected 1", length, i);
        // The sum is not finite if any of its numbers is not finite.
        if (!std::isfinite(glm::length(rays.origin[i]) + rays.time_offset_s[i]))
            fail("sensor: the origin or time of ray {} is not finite", i);
    }
}

/// Reads the rays of a sensor that a Python user has defined. Origins, times and rings
/// are optional and are 0 by default.
RayTable read_rays(const py::dict& dict) {
    if (!dict.contains("directions"))
        throw DataError(
            "sensor: the dict has no entry \"directions\", expected a dict of arrays with the names that "
            "relidar.rays() returns");
    const py::object directions = to_numpy(dict["directions"]);
    check_array(directions, "sensor: directions", py::dtype::of<float>(), {kAnyLength, kAnyLength, 3});
    const auto array = py::reinterpret_borrow<py::array>(directions);
    const NumpyShape image{array.shape(0), array.shape(1)}, vectors{image[0], image[1], 3};
    RayTable rays;
    rays.rows = static_cast<int>(image[0]);
    rays.columns = static_cast<int>(image[1]);
    rays.direction = to_scan_array(copy_array<float, glm::vec3>(directions, "sensor: directions", vectors));
    const auto get_optional_array = [&](const char* name) {
        return dict.contains(name) ? py::object(dict[name]) : py::object();
    };
    const std::size_t n = rays.size();
    const py::object origin = get_optional_array("origin"), time = get_optional_array("time"),
                     ring = get_optional_array("ring");
    rays.origin.resize(n);
    rays.time_offset_s.resize(n);
    rays.channel.resize(n);
    if (origin) rays.origin = to_scan_array(copy_array<float, glm::vec3>(origin, "sensor: origin", vectors));
    if (time) rays.time_offset_s = to_scan_array(copy_array<float, float>(time, "sensor: time", image));
    if (ring)
        rays.channel = to_scan_array(copy_array<std::uint16_t, std::uint16_t>(ring, "sensor: ring", image));
    check_rays(rays);
    return rays;
}

}  // namespace

SimulatedSensor sensor_for_run(const py::handle& sensor, const Run& run, int lidar) {
    if (sensor.is_none()) return make_sensor(run.config, run.log, lidar);
    if (py::isinstance<py::str>(sensor))
        return choose_sensor(sensor.cast<std::string>(), run.config, run.log, lidar);
    if (!py::isinstance<py::dict>(sensor))
        throw UsageError(
            "sensor: found an unsupported type, expected a name from relidar.sensors(), the path of a sensor "
            "file, or a dict with \"directions\"");
    SimulatedSensor simulated;
    simulated.rays = read_rays(py::reinterpret_borrow<py::dict>(sensor));
    // The rays have no range limits, so only the limits of the dataset apply.
    simulated.limits = intersect({}, {run.config.dataset.min_range_m, run.config.dataset.max_range_m});
    simulated.name = "rays";
    simulated.lidar = lidar;
    return simulated;
}

Camera camera_for_run(const py::object& camera, const Run& run, int lidar) {
    if (py::isinstance<py::str>(camera)) return choose_camera(camera.cast<std::string>(), run.log, lidar);
    if (!py::isinstance<py::dict>(camera))
        throw UsageError(
            "camera: found an unsupported type, expected a name, the path of a JSON file, or a dict "
            "with \"K\" and \"size\"");
    const py::cpp_function to_list([](const py::object& array) { return array.attr("tolist")(); });
    const py::object text = py::module_::import("json").attr("dumps")(camera, py::arg("default") = to_list);
    return parse_camera(text.cast<std::string>(), "camera");
}

py::dict to_array_dict(const RayTable& rays) {
    const NumpyShape image{rays.rows, rays.columns}, vectors{rays.rows, rays.columns, 3};
    py::dict dict;
    dict["directions"] = move_to_numpy<float>(to_vector(rays.direction), vectors);
    dict["origin"] = move_to_numpy<float>(to_vector(rays.origin), vectors);
    dict["time"] = move_to_numpy<float>(to_vector(rays.time_offset_s), image);
    dict["ring"] = move_to_numpy<std::uint16_t>(to_vector(rays.channel), image);
    return dict;
}

/// Adds relidar.sensors() and relidar.rays().
void bind_sensors(py::module_& module) {
    module.def("sensors", &list_sensors,
               "Returns the names of the sensors that rays() and Run.render() accept in addition to "
               "\"native\", the sensor of the log.");
    module.def(
        "rays",
        [](const std::string& sensor, double time) {
            return to_array_dict(make_rays(find_sensor(sensor), time));
        },
        py::arg("sensor"), py::arg("time") = 0.0,
        "Returns the rays of one scan of a sensor. The sensor is a name or a file: a beam table such as "
        "\"beams.csv:1024x10\", a ray table, or\n"
        "Ouster metadata. The rays of a rosette sensor depend on the time, in seconds.\n\n"
        "Returns a dict: directions, origin [rows,columns,3] float32 (unit; metres; sensor frame), time "
        "[rows,columns] float32 (seconds after the head\n"
        "faces forward), ring [rows,columns] uint16 (beam, 0 is the highest). Run.render() accepts such a "
        "dict as its sensor.");
}

}  // namespace relidar::python
