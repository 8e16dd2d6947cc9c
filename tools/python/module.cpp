// SPDX-License-Identifier: Apache-2.0
// Python module that exports the public interface of the library with numpy arrays. Users
// import relidar/__init__.py, which exports the same names.
#include "module.hpp"

PYBIND11_MODULE(_relidar, module) {
    using namespace relidar::python;
    module.doc() =
        "LiDAR re-simulation on any Vulkan device. Units are metres, seconds and radians. The "
        "sensor frame has x forward, y left, z up.";
    module.attr("__version__") = RELIDAR_VERSION;
    add_errors(module);
    add_device(module);
    add_config(module);
    add_poses(module);
    add_sensors(module);
    add_sequence(module);
    add_scene(module);
    add_run(module);
    add_edit(module);
    add_train(module);
    add_evaluate(module);
    add_pictures(module);
    add_differentiable_renderer(module);
}
