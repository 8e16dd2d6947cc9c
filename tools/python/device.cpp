// SPDX-License-Identifier: Apache-2.0
#include "device.hpp"

#include <pybind11/stl.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "module.hpp"

namespace relidar::python {
namespace {

SharedDevice& default_device() {
    static SharedDevice device;
    return device;
}

SharedDevice open_device(int index, const std::string& traversal, std::uint64_t memory_limit_bytes,
                         bool validation) {
    if (index < -1)
        throw UsageError(fmt::format(
            "opening a device: index: found {}, expected a number that relidar.devices() lists, or -1",
            index));
    DeviceOptions options;
    options.index = index;
    options.traversal = find_traversal(traversal);
    options.memory_limit_bytes = memory_limit_bytes;
    options.validation = validation;
    const py::gil_scoped_release others_run;
    return std::make_shared<OpenDevice>(from_environment(options));
}

const char* name_of(Traversal traversal) {
    return traversal == Traversal::software ? "software" : "ray_query";
}

std::string shown(const OpenDevice& open) {
    return fmt::format("<relidar.Device {}: {}, {}>", open.device.info().index, open.device.info().name,
                       name_of(open.device.traversal()));
}

}  // namespace

SharedDevice device_or_default(SharedDevice device) {
    if (device) return device;
    if (!default_device()) default_device() = open_device(-1, "auto", 0, false);
    return default_device();
}

DeviceUse::DeviceUse(OpenDevice& device) : device_(device) {
    if (device.user == std::this_thread::get_id())
        throw UsageError(
            "using a device: found it busy with the call that has called back, expected callbacks to use "
            "another relidar.Device");
    lock_ = std::unique_lock(device.in_use);
    device.user = std::this_thread::get_id();
}

DeviceUse::~DeviceUse() { device_.user = std::thread::id(); }

void add_device(py::module_& module) {
    py::class_<DeviceInfo>(module, "DeviceInfo",
                           "One Vulkan device of this machine and what relidar can do with it.")
        .def_readonly("index", &DeviceInfo::index)
        .def_readonly("name", &DeviceInfo::name)
        .def_readonly("type", &DeviceInfo::type, "\"discrete GPU\", \"integrated GPU\", \"CPU\", ...")
        .def_readonly("driver", &DeviceInfo::driver)
        .def_readonly("api_version", &DeviceInfo::api_version)
        .def_readonly("memory_bytes", &DeviceInfo::memory_bytes, "Of the largest device-local heap.")
        .def_readonly("ray_query", &DeviceInfo::ray_query, "Whether the driver's ray queries can be used.")
        .def_readonly("software", &DeviceInfo::software, "Whether relidar's own tree can be used.")
        .def_readonly("why_not_usable", &DeviceInfo::why_not_usable,
                      "Missing features; empty where relidar runs.");
    module.def("devices", &list_devices, py::call_guard<py::gil_scoped_release>(),
               "All Vulkan devices, in the loader's order. Raises DeviceError where there is no Vulkan.");

    py::class_<OpenDevice, SharedDevice>(
        module, "Device",
        "An open Vulkan device. It stays open for what was made on it, and serves one thread at a time.")
        .def(py::init(&open_device), py::arg("index") = -1, py::arg("traversal") = "auto", py::kw_only(),
             py::arg("memory_limit_bytes") = 0, py::arg("validation") = false,
             "Opens a device.\n\n"
             "index: of devices(); -1: the first GPU, one with ray query before others, else a CPU device\n"
             "traversal: how rays find surfels: \"auto\", \"ray_query\" or \"software\"\n"
             "memory_limit_bytes: device memory it may hold; 0: all there is\n"
             "validation: with the Khronos validation layer\n"
             "The environment is asked too: RELIDAR_VALIDATION, RELIDAR_MEMORY_LIMIT_MIB, "
             "RELIDAR_PIPELINE_CACHE.\n\n"
             "Raises DeviceError naming what is missing.")
        .def_property_readonly("info", [](const OpenDevice& open) { return open.device.info(); })
        .def_property_readonly(
            "traversal", [](const OpenDevice& open) { return name_of(open.device.traversal()); },
            "\"ray_query\" or \"software\".")
        .def_property_readonly(
            "peak_bytes", [](const OpenDevice& open) { return open.device.peak_bytes(); },
            "Most device memory held so far, bytes.")
        .def("__repr__", &shown);
    // Closes the default device at exit, before the Python interpreter and the Vulkan
    // loader end.
    py::module_::import("atexit").attr("register")(py::cpp_function([] { default_device().reset(); }));
}

}  // namespace relidar::python
