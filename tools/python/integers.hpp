// SPDX-License-Identifier: Apache-2.0
// Reads integer arguments of Python calls. For a wrong integer, pybind11 alone would
// print all signatures of the function.
#pragma once

#include <algorithm>
#include <limits>
#include <string>

#include <pybind11/pybind11.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar::python {

/// Converts a Python integer, or an object that Python accepts as an index.
/// @throws pybind11::type_error if the object is no integer
/// @throws UsageError if the integer does not fit into Integer
template <class Integer>
Integer read_integer(const pybind11::handle& object, const std::string& where) {
    using Limits = std::numeric_limits<Integer>;
    const auto describe_problem = [&] {
        return fmt::format("{}: found {}, expected a whole number from {} to {}", where,
                           std::string(pybind11::repr(object)), Limits::min(), Limits::max());
    };
    // PyNumber_Index() accepts integers of Python and numpy, but rejects floats.
    const auto integer = pybind11::reinterpret_steal<pybind11::object>(PyNumber_Index(object.ptr()));
    if (!integer) {
        PyErr_Clear();
        throw pybind11::type_error(describe_problem());
    }
    // Compares as Python integers, which cannot overflow.
    if (integer < pybind11::int_(Limits::min()) || integer > pybind11::int_(Limits::max()))
        throw UsageError(describe_problem());
    return integer.cast<Integer>();
}

template <std::size_t N>
struct ArgumentName {
    char text[N];
    constexpr ArgumentName(const char (&name)[N]) { std::copy_n(name, N, text); }
};

template <class Integer, ArgumentName name>
struct IntegerArgument {
    Integer value;
    operator Integer() const { return value; }
};

}  // namespace relidar::python

template <class Integer, relidar::python::ArgumentName argument>
struct pybind11::detail::type_caster<relidar::python::IntegerArgument<Integer, argument>> {
    using Argument = relidar::python::IntegerArgument<Integer, argument>;
    PYBIND11_TYPE_CASTER(Argument, const_name("int"));
    bool load(handle source, bool) {
        value.value =
            relidar::python::read_integer<Integer>(source, std::string("argument ") + argument.text);
        return true;
    }
};
