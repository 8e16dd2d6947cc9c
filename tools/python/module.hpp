// SPDX-License-Identifier: Apache-2.0
// Declares the functions that add the parts of the Python module. They are called in this
// order, because a part may use types of earlier parts.
#pragma once

#include <pybind11/pybind11.h>

namespace relidar::python {

void add_errors(pybind11::module_& module);
void add_device(pybind11::module_& module);
void add_config(pybind11::module_& module);
void add_poses(pybind11::module_& module);
void add_sensors(pybind11::module_& module);
void add_sequence(pybind11::module_& module);
void add_scene(pybind11::module_& module);
void add_run(pybind11::module_& module);
void add_edit(pybind11::module_& module);
void add_train(pybind11::module_& module);
void add_evaluate(pybind11::module_& module);
void add_pictures(pybind11::module_& module);
void add_differentiable_renderer(pybind11::module_& module);

}  // namespace relidar::python
