// SPDX-License-Identifier: Apache-2.0
// Converts C++ exceptions of the library to Python exceptions. Each exception class is
// also derived from the matching built-in exception of Python.
#include <string>

#include <relidar/base/error.hpp>
#include "module.hpp"

namespace relidar::python {
namespace {

namespace py = pybind11;

struct PythonErrorTypes {
    py::object error, usage, data, device;
};

/// Returns the Python exception types. They are never destroyed, because exceptions may
/// be raised until the interpreter ends.
PythonErrorTypes& exception_types() {
    static auto* const all = new PythonErrorTypes;
    return *all;
}

/// Creates the exception class relidar.TYPE_NAME. Its attribute `code` is the exit code
/// of the command line tool.
py::object add_type(py::module_& module, const char* type_name, const char* doc, const py::tuple& bases,
                    ExitCode exit_code) {
    py::dict members;
    members["code"] = static_cast<int>(exit_code);
    const std::string full_name = std::string("relidar.") + type_name;
    auto type = py::reinterpret_steal<py::object>(
        PyErr_NewExceptionWithDoc(full_name.c_str(), doc, bases.ptr(), members.ptr()));
    if (!type) throw py::error_already_set();
    module.attr(type_name) = type;
    return type;
}

/// Converts an exception of the library to the Python exception with the same meaning.
/// pybind11 handles all other exceptions.
void raise_exception(std::exception_ptr exception) {
    try {
        if (exception) std::rethrow_exception(exception);
    } catch (const UsageError& error) {
        PyErr_SetString(exception_types().usage.ptr(), error.what());
    } catch (const DataError& error) {
        PyErr_SetString(exception_types().data.ptr(), error.what());
    } catch (const DeviceError& error) {
        PyErr_SetString(exception_types().device.ptr(), error.what());
    } catch (const Error& error) {
        const py::object instance = exception_types().error(error.what());
        instance.attr("code") = static_cast<int>(error.code());
        PyErr_SetObject(exception_types().error.ptr(), instance.ptr());
    }
}

}  // namespace

void bind_errors(py::module_& module) {
    const auto builtin = [](PyObject* type) { return py::reinterpret_borrow<py::object>(type); };
    PythonErrorTypes& all = exception_types();
    all.error = add_type(module, "Error",
                         "Base class of all errors of relidar. `code` is the corresponding exit code of the "
                         "command line tool.",
                         py::make_tuple(builtin(PyExc_Exception)), ExitCode::bug);
    all.usage = add_type(module, "UsageError", "A name, a setting or a combination of arguments is wrong.",
                         py::make_tuple(all.error, builtin(PyExc_ValueError)), ExitCode::usage);
    all.data =
        add_type(module, "DataError", "A file or array is missing or invalid, or output cannot be written.",
                 py::make_tuple(all.error, builtin(PyExc_ValueError)), ExitCode::data);
    all.device = add_type(module, "DeviceError",
                          "No device is available, a feature is missing, a Vulkan call failed, or the device "
                          "memory is exhausted.",
                          py::make_tuple(all.error, builtin(PyExc_RuntimeError)), ExitCode::device);
    py::register_exception_translator(raise_exception);
}

}  // namespace relidar::python
