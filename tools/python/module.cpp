// SPDX-License-Identifier: Apache-2.0
// Python module that exports the public interface of the library with numpy arrays. Users
// import relidar/__init__.py, which exports the same names.
#include "module.hpp"

PYBIND11_MODULE(_relidar, module) {
    using namespace relidar::python;
    module.doc() =
        "LiDAR re-simulation on any Vulkan device. Units are metres, seconds and radians. The sensor frame "
        "has x forward, y left, z up.";
    module.attr("__version__") = RELIDAR_VERSION;
    bind_errors(module);
    bind_device(module);
    bind_device_array(module);
    bind_config(module);
    bind_poses(module);
    bind_sensors(module);
    bind_sequence(module);
    bind_scene(module);
    bind_run_class(module);
    bind_edit_class(module);
    bind_train(module);
    bind_evaluate(module);
    bind_pictures(module);
    bind_renderer(module);
}
