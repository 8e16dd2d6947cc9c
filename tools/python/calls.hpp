// SPDX-License-Identifier: Apache-2.0
// Calls from the library into Python during work that has released the interpreter lock.
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

/// Python callback for progress: receives the name of the step and the finished share.
using Tell = std::optional<std::function<void(const std::string&, double)>>;

/// Wraps a Python callback as a Progress of the library. Exceptions of the callback,
/// including KeyboardInterrupt, leave the library immediately. Use it only for work that
/// may be aborted anywhere.
inline Progress told_to(const Tell& tell) {
    return [&tell](std::string_view what, double done) {
        const py::gil_scoped_acquire interpreter;
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (tell) (*tell)(std::string(what), done);
    };
}

/// Calls into Python from the library. After the first exception, including Ctrl-C, the
/// work stops in an orderly way. The exception is raised again afterwards.
class PythonCalls {
public:
    /// Calls a Python function and records its first exception.
    /// @return false from the first exception on; the work must then stop
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
    /// Returns true if no exception was raised. Checks for Ctrl-C first.
    bool go_on() {
        return (*this)([] {});
    }
    void raise_again() const {
        if (failure_) std::rethrow_exception(failure_);
    }

private:
    std::exception_ptr failure_;
};

}  // namespace relidar::python
