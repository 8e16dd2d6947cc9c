// SPDX-License-Identifier: Apache-2.0
#include "device.hpp"

#include <cstdio>

#include <pybind11/stl.h>

#include <relidar/diff/first_use.hpp>
#include "base/fail.hpp"
#include "integers.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

SharedDevice& default_device() {
    static SharedDevice device;
    return device;
}

/// Opens a device for Python. The help text of relidar.Device describes the arguments.
SharedDevice open_device(IntegerArgument<int, "index"> index, const std::string& traversal,
                         IntegerArgument<std::uint64_t, "memory_limit_bytes"> memory_limit_bytes,
                         bool enable_validation, bool share_memory) {
    if (index < -1)
        fail<UsageError>(
            "cannot open a device: found the index {}, expected an index of relidar.devices(), or -1",
            index.value);
    DeviceOptions options;
    options.index = index;
    options.traversal = parse_backend(traversal);
    options.memory_limit_bytes = memory_limit_bytes;
    options.validation = enable_validation;
    options.share_memory = share_memory;
    // Releases the GIL, so that other Python threads run while the device opens.
    const py::gil_scoped_release gil_released;
    return std::make_shared<LockableDevice>(apply_environment(options));
}

const char* format_traversal(RayTracingBackend traversal) {
    return traversal == RayTracingBackend::software ? "software" : "ray_query";
}

std::string device_repr(const LockableDevice& device) {
    return fmt::format("<relidar.Device {}: {}, {}>", device.device.info().index, device.device.info().name,
                       format_traversal(device.device.backend()));
}

}  // namespace

SharedDevice device_or_default(SharedDevice device) {
    if (device) return device;
    if (!default_device()) default_device() = open_device({-1}, "auto", {0}, false, true);
    return default_device();
}

DeviceLock::DeviceLock(LockableDevice& device) : device_(device) {
    // First, because in a forked process, the thread that held the lock does not exist.
    device.device.check_process();
    if (device.user == std::this_thread::get_id())
        throw UsageError(
            "cannot use this device: it is busy with the call that runs the current callback; use another "
            "relidar.Device in callbacks");
    lock_ = std::unique_lock(device.in_use);
    device.user = std::this_thread::get_id();
}

DeviceLock::~DeviceLock() { device_.user = std::thread::id(); }

void bind_device(py::module_& module) {
    set_open_callbacks({test_device, [](const std::string& text) {
                            std::fprintf(stderr, "relidar: note: %s\n", text.c_str());
                        }});
    py::class_<DeviceInfo>(module, "DeviceInfo",
                           "A Vulkan device of this machine and the features that relidar can use.")
        .def_readonly("index", &DeviceInfo::index)
        .def_readonly("name", &DeviceInfo::name)
        .def_readonly("type", &DeviceInfo::type, "\"discrete GPU\", \"integrated GPU\", \"CPU\", ...")
        .def_readonly("driver", &DeviceInfo::driver)
        .def_readonly("api_version", &DeviceInfo::api_version)
        .def_readonly("memory_bytes", &DeviceInfo::memory_bytes,
                      "Size of the largest device-local memory heap, in bytes.")
        .def_readonly("ray_query", &DeviceInfo::ray_query,
                      "True if relidar can use the ray queries of the driver.")
        .def_readonly("software", &DeviceInfo::software,
                      "True if relidar can use software traversal of its BVH.")
        .def_readonly("why_not_usable", &DeviceInfo::why_not_usable,
                      "Missing features. Empty if relidar can use the device.");
    module.def("devices", &list_devices, py::call_guard<py::gil_scoped_release>(),
               "Returns all Vulkan devices, in the order of the Vulkan loader. Raises DeviceError if Vulkan "
               "is not available.");

    py::class_<LockableDevice, SharedDevice>(
        module, "Device",
        "An open Vulkan device. It stays open as long as objects that were made with it exist. It can be "
        "used by one thread at a time.")
        .def(py::init(&open_device), py::arg("index") = -1, py::arg("traversal") = "auto", py::kw_only(),
             py::arg("memory_limit_bytes") = 0, py::arg("validation") = false, py::arg("share_memory") = true,
             "Opens a device.\n\n"
             "index: index in devices(); -1: the first GPU with ray query, otherwise the first GPU, "
             "otherwise a CPU device\n"
             "traversal: method to trace rays: \"auto\", \"ray_query\" or \"software\"\n"
             "memory_limit_bytes: maximum device memory to allocate; 0: no limit\n"
             "validation: enable the Khronos validation layer\n"
             "share_memory: allow tensors of other libraries to use the memory of the device "
             "(relidar.DeviceArray); False: they are copies\n"
             "These environment variables also have an effect: RELIDAR_VALIDATION, RELIDAR_MEMORY_LIMIT_MIB, "
             "RELIDAR_PIPELINE_CACHE.\n\n"
             "Raises DeviceError that names the missing feature.")
        .def_property_readonly("info", [](const LockableDevice& open) { return open.device.info(); })
        .def_property_readonly(
            "traversal", [](const LockableDevice& open) { return format_traversal(open.device.backend()); },
            "\"ray_query\" or \"software\".")
        .def_property_readonly(
            "peak_bytes", [](const LockableDevice& open) { return open.device.peak_bytes(); },
            "Maximum device memory that was allocated so far, in bytes.")
        .def_property_readonly(
            "transfers",
            [](const LockableDevice& open) {
                const TransferCounts n = open.device.transfers();
                return py::dict(py::arg("uploads") = n.uploads, py::arg("upload_bytes") = n.upload_bytes,
                                py::arg("downloads") = n.downloads,
                                py::arg("download_bytes") = n.download_bytes,
                                py::arg("staged_bytes") = n.staged_bytes);
            },
            "Dict of the copies so far between host and device: uploads, upload_bytes, downloads, "
            "download_bytes (of arrays), staged_bytes (kernel parameters, poses and other values in "
            "commands).")
        .def("__repr__", &device_repr);
    // Closes the default device at exit. The Python interpreter and the Vulkan loader
    // must still exist at this time.
    py::module_::import("atexit").attr("register")(py::cpp_function([] { default_device().reset(); }));
}

}  // namespace relidar::python
