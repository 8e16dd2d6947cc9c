// SPDX-License-Identifier: Apache-2.0

#include <pybind11/stl/filesystem.h>

#include <relidar/base/error.hpp>
#include <relidar/base/images.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>
#include "arrays.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

py::object required_entry(const py::dict& scan_dict, const char* entry_name) {
    if (!scan_dict.contains(entry_name))
        throw DataError(std::string("scan: the dict has no entry \"") + entry_name +
                        "\", expected range, intensity and drop_prob");
    return scan_dict[entry_name];
}

/// Converts a scan dict from Python to a rendered scan. The dict of a measured scan has
/// no drop_prob, so a ray with range 0 counts as a ray without return.
RenderedScan to_rendered_scan(const py::dict& scan_dict) {
    const py::object range = to_numpy(required_entry(scan_dict, "range"));
    check_array(range, "scan: range", py::dtype::of<float>(), {kAnyLength, kAnyLength});
    const auto array = py::reinterpret_borrow<py::array>(range);
    const NumpyShape shape{array.shape(0), array.shape(1)};
    RenderedScan result;
    result.image.rows = static_cast<int>(shape[0]);
    result.image.columns = static_cast<int>(shape[1]);
    result.image.range_m = copy_array<float, float>(range, "scan: range", shape);
    result.image.intensity =
        copy_array<float, float>(required_entry(scan_dict, "intensity"), "scan: intensity", shape);
    if (scan_dict.contains("drop_prob"))
        result.image.drop_prob = copy_array<float, float>(scan_dict["drop_prob"], "scan: drop_prob", shape);
    else
        for (const float range_m : result.image.range_m)
            result.image.drop_prob.push_back(range_m > 0.0f ? 0.0f : 1.0f);
    return result;
}

}  // namespace

/// Adds relidar.write_picture().
void bind_pictures(py::module_& module) {
    module.def(
        "write_picture",
        [](const std::filesystem::path& path, const py::dict& scan) {
            write_png(path, draw_scan(to_rendered_scan(scan)));
        },
        py::arg("path"), py::arg("scan"),
        "Writes a PNG image of a scan: range in false colours, intensity and drop probability below each "
        "other.\n\n"
        "scan: range, intensity and drop_prob, [rows,columns] float32; a scan of a log needs no drop_prob");
}

}  // namespace relidar::python
