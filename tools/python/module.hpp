// SPDX-License-Identifier: Apache-2.0
// Declares the functions that add the parts of the Python module. They are called in this
// order, because a part may use types of earlier parts.
#pragma once

#include <pybind11/pybind11.h>

namespace relidar::python {

void bind_device(pybind11::module_& module);
void bind_device_array(pybind11::module_& module);
void bind_config(pybind11::module_& module);
void bind_poses(pybind11::module_& module);
void bind_sensors(pybind11::module_& module);
void bind_log(pybind11::module_& module);
void bind_scene(pybind11::module_& module);
void bind_run_class(pybind11::module_& module);
void bind_edit_class(pybind11::module_& module);
void bind_train(pybind11::module_& module);
void bind_evaluate(pybind11::module_& module);
void bind_pictures(pybind11::module_& module);
void bind_renderer(pybind11::module_& module);

}  // namespace relidar::python
