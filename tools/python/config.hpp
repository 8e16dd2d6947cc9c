// SPDX-License-Identifier: Apache-2.0
// Settings from Python. Names are those of `relidar list settings`; values are Python
// values.
#pragma once

#include <string>

#include <pybind11/pybind11.h>

#include <relidar/run/config.hpp>

namespace relidar::python {

/// Sets one setting from a str, bool, int, float or path.
/// @throws UsageError as set_key(), and for a value of another type
void set_value(Config& config, const std::string& key, const pybind11::handle& value);
/// Raises a note of the library as a Python warning.
void warn(const std::string& text);
/// Sets all settings of a dict.
void set_values(Config& config, const pybind11::dict& values);

}  // namespace relidar::python
