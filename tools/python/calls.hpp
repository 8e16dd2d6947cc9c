// SPDX-License-Identifier: Apache-2.0
// Lets the library call Python functions during work that has released the interpreter
// lock (GIL).
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

/// Python callback that receives the progress: the name of the step, and the finished
/// share from 0 to 1.
using Tell = std::optional<std::function<void(const std::string&, double)>>;

/// Converts a Python callback to a Progress of the library. If the callback raises an
/// exception, the work of the library is aborted immediately. Ctrl-C has the same effect.
/// Use it only for work that may be aborted at any point.
inline Progress collect_into(const Tell& tell) {
    return [&tell](std::string_view what, double done) {
        const py::gil_scoped_acquire interpreter;
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (tell) (*tell)(std::string(what), done);
    };
}

/// Calls Python functions from the library. After the first exception or Ctrl-C, the
/// library stops its work at a safe point. Then the exception is raised again.
class PythonCalls {
public:
    /// Calls a Python function and stores the first exception that a call raises.
    /// @return false if a call has raised an exception; the caller must then stop its
    /// work
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
    /// Checks for Ctrl-C. Returns true if no exception was raised, so that the work can
    /// continue.
    bool go_on() {
        return (*this)([] {});
    }
    void rethrow() const {
        if (failure_) std::rethrow_exception(failure_);
    }

private:
    std::exception_ptr failure_;
};

}  // namespace relidar::python
