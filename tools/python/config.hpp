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
void set_value(Config& config, const std::string& key, const pybind11::handle& value);
/// Shows a note of the C++ library as a Python warning.
void warn(const std::string& text);
/// Sets each setting that the dict contains.
void set_values(Config& config, const pybind11::dict& values);

}  // namespace relidar::python
