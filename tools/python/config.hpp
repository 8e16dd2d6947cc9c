// SPDX-License-Identifier: Apache-2.0
// Reads and writes settings from Python. `relidar list settings` prints the names of the
// settings. The values are Python values.
#pragma once

#include <string>

#include <pybind11/pybind11.h>

#include <relidar/run/config.hpp>

namespace relidar::python {

/// Sets one setting. The value is a str, bool, int, float or path.
/// @throws UsageError if the type of the value is wrong, or if set_config_value() rejects
/// the key or the value
void set_config_value_from_python(Config& config, const std::string& key, const pybind11::handle& value);
/// Shows a note of the C++ library as a Python warning.
void show_python_warning(const std::string& message);
/// Sets each setting that the dict contains.
void set_config_values_from_python(Config& config, const pybind11::dict& settings);

}  // namespace relidar::python
