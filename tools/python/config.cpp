// SPDX-License-Identifier: Apache-2.0
#include "conversions.hpp"

#include <algorithm>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <relidar/run/config.hpp>
#include "base/fail.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

std::string setting_text(const std::string& key, const py::handle& value) {
    if (py::isinstance<py::str>(value)) return value.cast<std::string>();
    if (py::isinstance<py::bool_>(value)) return value.cast<bool>() ? "true" : "false";
    if (py::isinstance<py::int_>(value) || py::isinstance<py::float_>(value)) return py::repr(value);
    if (py::hasattr(value, "__fspath__")) return value.cast<std::filesystem::path>().string();
    fail<UsageError>("setting {}: found a value of type {}, expected str, bool, int, float or a path", key,
                     std::string(py::str(py::type::handle_of(value).attr("__name__"))));
}

/// Returns a setting. For an unknown name, the error suggests similar names.
ConfigKey existing_key(const Config& config, const std::string& key) {
    const std::vector<ConfigKey> keys = list_config_keys(config);
    const auto it = std::find_if(keys.begin(), keys.end(), [&](const ConfigKey& k) { return k.key == key; });
    if (it != keys.end()) return *it;
    std::vector<std::string> names;
    for (const ConfigKey& k : keys) names.push_back(k.key);
    fail<UsageError>("setting {}: unknown key{}", key,
                     did_you_mean(key, names, "", ", expected one of the names in Config.values()"));
}

Config make_config(const std::string& preset, const py::dict& settings) {
    Config config = make_preset(preset);
    set_values(config, settings);
    return config;
}

Config load_config(const std::filesystem::path& path) {
    Config config = make_preset("default");
    apply_file(config, path);
    return config;
}

py::dict config_dict(const Config& config) {
    py::dict values;
    for (const ConfigKey& key : list_config_keys(config)) values[py::str(key.key)] = key.value;
    return values;
}

}  // namespace

void show_warning(const std::string& message) {
    if (PyErr_WarnEx(PyExc_UserWarning, message.c_str(), 1) != 0) throw py::error_already_set();
}

void set_value(Config& config, const std::string& key, const py::handle& value) {
    set_value(config, key, setting_text(key, value));
}

void set_values(Config& config, const py::dict& settings) {
    for (const auto& [key, value] : settings) {
        if (!py::isinstance<py::str>(key))
            throw UsageError(
                "settings: found a key that is not a str, expected names of settings such as "
                "\"train.iterations\"");
        set_value(config, key.cast<std::string>(), value);
    }
}

/// Adds relidar.Config, a dict-like class. Here and in the other bind_ functions, the
/// texts are the documentation of the Python module.
void bind_config(py::module_& module) {
    py::class_<Config>(module, "Config",
                       "All settings of a run. They have the names that `relidar list settings` prints, for "
                       "example config[\"train.iterations\"] = 300.")
        .def(py::init(&make_config), py::arg("preset") = "default", py::arg("settings") = py::dict(),
             "preset: \"paper\", \"released\", \"default\" or \"quick\"\n"
             "settings: dict of names and values that replace those of the preset\n\n"
             "Raises UsageError for unknown names and for values out of range.")
        .def_static("load", &load_config, py::arg("path"),
                    "Reads settings from a TOML file, such as config.toml in a run folder. Raises UsageError "
                    "or DataError with a description of the error.")
        .def(
            "__getitem__",
            [](const Config& config, const std::string& key) { return existing_key(config, key).value; },
            py::arg("key"), "Returns the value as text, in the same form as in the TOML file.")
        .def("__setitem__", &set_value, py::arg("key"), py::arg("value"))
        .def(
            "help",
            [](const Config& config, const std::string& key) { return existing_key(config, key).help; },
            py::arg("key"), "Returns the description of a setting.")
        .def("values", &config_dict,
             "Returns all settings as a dict of texts, in the order of the TOML file.")
        .def(
            "copy", [](const Config& config) { return config; }, "Returns a copy of the settings.")
        .def("to_toml", &to_toml,
             "Returns all values as TOML text, with descriptions as comments. load() can read this text.");
}

}  // namespace relidar::python
