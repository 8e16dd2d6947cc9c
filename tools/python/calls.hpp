// SPDX-License-Identifier: Apache-2.0
// Calls Python functions from C++ code that has released the global interpreter lock
// (GIL).
#pragma once

#include <exception>
#include <functional>
#include <optional>
#include <string>

#include <pybind11/functional.h>
#include <pybind11/stl.h>

#include <relidar/base/progress.hpp>

namespace relidar::python {

namespace py = pybind11;

using PythonProgressCallback = std::optional<std::function<void(const std::string&, double)>>;

/// Converts a Python callback to a C++ progress callback. If the Python callback raises
/// an exception or the user presses Ctrl-C, the work is aborted immediately. Use it only
/// for work that can be aborted at any point.
inline Progress wrap_progress(const PythonProgressCallback& python_callback) {
    return [&python_callback](std::string_view text, double done) {
        const py::gil_scoped_acquire interpreter;
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (python_callback) (*python_callback)(std::string(text), done);
    };
}

/// Lets C++ code call Python functions. After an exception or Ctrl-C, calls return false,
/// so that the C++ code can stop. rethrow() then raises the exception.
class PythonCallGuard {
public:
    /// Calls a Python function and stores the first exception that any call raises.
    /// Returns false after an exception, so that the caller must stop its work.
    template <class Call>
    bool operator()(Call&& call) {
        if (failure_) return false;
        const py::gil_scoped_acquire interpreter;
        try {
            if (PyErr_CheckSignals() != 0) throw py::error_already_set();
            call();
        } catch (...) {
            failure_ = std::current_exception();
        }
        return !failure_;
    }
    bool can_continue() {
        return (*this)([] {});
    }
    void rethrow() const {
        if (failure_) std::rethrow_exception(failure_);
    }

private:
    std::exception_ptr failure_;
};

}  // namespace relidar::python
