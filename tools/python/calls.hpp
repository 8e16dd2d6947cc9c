// SPDX-License-Identifier: Apache-2.0
// How the library calls back into Python, from work during which other threads run
// Python.
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

/// What Python gives to be told of progress: what is done, and its share.
using Tell = std::optional<std::function<void(const std::string&, double)>>;

/// The same for the library. What is raised there, KeyboardInterrupt too, leaves the
/// library at once: for work that may be left anywhere.
inline Progress told_to(const Tell& tell) {
    return [&tell](std::string_view what, double done) {
        const py::gil_scoped_acquire interpreter;
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (tell) (*tell)(std::string(what), done);
    };
}

/// Calls into Python from within the library. The first exception there, Ctrl-C's too,
/// ends the work in order; it is raised again after it.
class PythonCalls {
public:
    /// @return false from the first exception on: the work is to stop
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
    /// Whether nothing was raised so far, Ctrl-C looked for.
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
