// SPDX-License-Identifier: Apache-2.0
// Declares the functions that add the parts of the Python module. They are called in this
// order, because a part may use types of earlier parts.
#pragma once

#include <pybind11/pybind11.h>

namespace relidar::python {

void bind_error_types(pybind11::module_& module);
void bind_device_class(pybind11::module_& module);
void bind_config_class(pybind11::module_& module);
void bind_pose_functions(pybind11::module_& module);
void bind_sensor_functions(pybind11::module_& module);
void bind_sequence_class_and_loading(pybind11::module_& module);
void bind_scene_class(pybind11::module_& module);
void bind_run_class(pybind11::module_& module);
void bind_edit_class(pybind11::module_& module);
void bind_train_function(pybind11::module_& module);
void bind_evaluate_function(pybind11::module_& module);
void bind_picture_functions(pybind11::module_& module);
void bind_differentiable_renderer(pybind11::module_& module);

}  // namespace relidar::python
