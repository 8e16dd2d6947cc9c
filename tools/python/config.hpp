// SPDX-License-Identifier: Apache-2.0
// Reads and writes settings from Python. `relidar list settings` prints the names of the
// settings. The values are Python values.
#pragma once

#include <string>

#include <pybind11/pybind11.h>

#include <relidar/run/config.hpp>

namespace relidar::python {

void set_value(Config& config, const std::string& key, const pybind11::handle& value);
void show_warning(const std::string& message);
void set_values(Config& config, const pybind11::dict& settings);

}  // namespace relidar::python
