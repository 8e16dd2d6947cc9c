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
    bind_error_types(module);
    bind_device_class(module);
    bind_config_class(module);
    bind_pose_functions(module);
    bind_sensor_functions(module);
    bind_sequence_class_and_loading(module);
    bind_scene_class(module);
    bind_run_class(module);
    bind_edit_class(module);
    bind_train_function(module);
    bind_evaluate_function(module);
    bind_picture_functions(module);
    bind_differentiable_renderer(module);
}
