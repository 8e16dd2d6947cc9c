// SPDX-License-Identifier: Apache-2.0
// Python module that exports the public interface of the library with numpy arrays. Users
// import relidar/__init__.py, which exports the same names.
#include "module.hpp"

#include <relidar/base/error.hpp>

namespace relidar::python {
namespace {

namespace py = pybind11;

/// Adds the exception class relidar.NAME. Its attribute `code` is the exit code of the
/// command line tool.
template <class CppError>
py::object add_error(py::module_& module, const char* name, const char* doc, const py::tuple& bases,
                     ExitCode code) {
    py::object type = py::register_exception<CppError>(module, name, bases);
    type.inc_ref();  // never destroyed, because the static variable of pybind11 outlives the interpreter
    type.attr("__module__") = "relidar";
    type.attr("__doc__") = doc;
    type.attr("code") = static_cast<int>(code);
    return type;
}

/// Converts errors without a Python class of their own to relidar.Error, with their exit
/// code. pybind11 calls this function with the current exception.
void raise_error(std::exception_ptr exception) {
    try {
        if (exception) std::rethrow_exception(exception);
    } catch (const Error& error) {
        const py::object type = py::module_::import("relidar._relidar").attr("Error");
        const py::object instance = type(error.what());
        instance.attr("code") = static_cast<int>(error.code());
        PyErr_SetObject(type.ptr(), instance.ptr());
    }
}

/// Adds exceptions for the errors of the library. They are also derived from the matching
/// built-in exceptions of Python. pybind11 tries those that are added last first.
void bind_errors(py::module_& module) {
    const py::handle value_error = PyExc_ValueError, runtime_error = PyExc_RuntimeError;
    const py::object base = add_error<Error>(module, "Error",
                                             "Base class of all errors of relidar. `code` is the "
                                             "corresponding exit code of the command line tool.",
                                             py::make_tuple(py::handle(PyExc_Exception)), ExitCode::bug);
    py::register_exception_translator(raise_error);
    add_error<UsageError>(module, "UsageError", "A name, a setting or a combination of arguments is wrong.",
                          py::make_tuple(base, value_error), ExitCode::usage);
    add_error<DataError>(module, "DataError",
                         "A file or array is missing or invalid, or output cannot be written.",
                         py::make_tuple(base, value_error), ExitCode::data);
    add_error<DeviceError>(module, "DeviceError",
                           "No device is available, a feature is missing, a Vulkan call failed, or the "
                           "device memory is exhausted.",
                           py::make_tuple(base, runtime_error), ExitCode::device);
}

}  // namespace
}  // namespace relidar::python

/// Builds the module when Python imports it. Errors come first, because the other parts
/// raise them. A class must be added before the functions that have it in their
/// arguments.
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
    bind_log(module);
    bind_scene(module);
    bind_run_class(module);
    bind_edit_class(module);
    bind_train(module);
    bind_evaluate(module);
    bind_pictures(module);
    bind_renderer(module);
}
