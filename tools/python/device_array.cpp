// SPDX-License-Identifier: Apache-2.0
#include "device_array.hpp"

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "module.hpp"

namespace relidar::python {
namespace {

// Structs of the DLPack specification, version 0.8.
struct DLTensor {
    void* data;
    std::int32_t device_type, device_id;
    std::int32_t ndim;
    std::uint8_t type_code, type_bits;
    std::uint16_t type_lanes;
    std::int64_t *shape, *strides;
    std::uint64_t byte_offset;
};
struct DLManagedTensor {
    DLTensor tensor;
    void* context;
    void (*deleter)(DLManagedTensor*);
};
constexpr const char* kCapsuleName = "dltensor";
constexpr std::int32_t kDlCpu = 1, kDlCuda = 2, kDlRocm = 10;

/// What a DLManagedTensor keeps alive, and the memory of its shape.
struct ExportedTensor {
    DLManagedTensor managed;
    DeviceArray array;
    std::vector<std::int64_t> shape, strides;
};

std::int32_t dlpack_type(MemoryAddress::Interface interface) {
    if (interface == MemoryAddress::Interface::cuda) return kDlCuda;
    return interface == MemoryAddress::Interface::hip ? kDlRocm : kDlCpu;
}

/// Returns the type code of DLPack: 0 int, 1 uint, 2 float.
std::uint8_t dlpack_type_code(char kind) {
    if (kind == 'f') return 2;
    return kind == 'u' ? 1 : 0;
}

py::dtype dtype_of(const DeviceArray& array) { return py::dtype(std::string(1, array.kind) + "4"); }

NumpyShape byte_strides(const DeviceArray& array) {
    NumpyShape strides = array.strides;
    for (py::ssize_t& stride : strides) stride *= 4;
    return strides;
}

/// Number of bytes from the first to the last number.
std::size_t span_bytes(const DeviceArray& array) {
    std::size_t last = 0;
    for (std::size_t i = 0; i < array.shape.size(); ++i) {
        if (array.shape[i] == 0) return 0;
        last += static_cast<std::size_t>((array.shape[i] - 1) * array.strides[i]);
    }
    return 4 * (last + 1);
}

bool is_host_visible(const DeviceArray& array) {
    return array.buffer.address_for_others().interface == MemoryAddress::Interface::host;
}

/// Returns the values as a numpy array with the strides of the device: a view of memory
/// that the host can access, otherwise a copy.
/// @param object the Python object of the array, which a view keeps alive
py::array to_host(const py::object& object) {
    const auto& array = object.cast<const DeviceArray&>();
    if (is_host_visible(array))
        return py::array(dtype_of(array), array.shape, byte_strides(array),
                         array.buffer.address_for_others().pointer + array.offset_bytes, object);
    const std::size_t n_bytes = span_bytes(array);
    py::array bytes(py::dtype::of<std::uint8_t>(), NumpyShape{static_cast<py::ssize_t>(n_bytes)});
    if (n_bytes > 0) {
        void* data = bytes.mutable_data();  // Needs the GIL, which DeviceLock releases.
        const DeviceLock use(*array.device);
        array.buffer.download(data, n_bytes, array.offset_bytes);
    }
    return py::array(dtype_of(array), array.shape, byte_strides(array), bytes.mutable_data(), bytes);
}

/// Replaces the values of an array by those of another object.
/// @param source a numpy array or a DLPack tensor of the same shape and dtype
void copy_values(const py::object& object, const py::object& source) {
    auto& array = object.cast<DeviceArray&>();
    const py::object values = to_numpy(source);
    check_dtype(values, "copy_from", dtype_of(array), array.shape);
    py::array host = to_host(object);
    py::module_::import("numpy").attr("copyto")(host, values);
    const std::size_t n_bytes = span_bytes(array);
    if (is_host_visible(array) || n_bytes == 0) return;  // `host` is a view of the array.
    const void* data = host.data();                      // Needs the GIL, which DeviceLock releases.
    const DeviceLock use(*array.device);
    array.buffer.upload(data, n_bytes, array.offset_bytes);
}

/// Describes the memory of an array to other libraries.
DLTensor describe_tensor(ExportedTensor& exported, const MemoryAddress& address) {
    const DeviceArray& array = exported.array;
    // Adds the offset to the pointer, because PyTorch before 2.0 ignores `byte_offset`.
    return {.data = address.pointer + array.offset_bytes,
            .device_type = dlpack_type(address.interface),
            .device_id = address.device_index,
            .ndim = static_cast<std::int32_t>(exported.shape.size()),
            .type_code = dlpack_type_code(array.kind),
            .type_bits = 32,
            .type_lanes = 1,  // numbers, not short vectors
            .shape = exported.shape.data(),
            .strides = exported.strides.data(),
            .byte_offset = 0};
}

/// Frees the tensor of a capsule that nobody has used. A library that uses the tensor
/// renames the capsule, and calls the deleter itself when it no longer needs the memory.
void free_unused(PyObject* capsule) {
    if (!PyCapsule_IsValid(capsule, kCapsuleName)) return;
    auto* managed = static_cast<DLManagedTensor*>(PyCapsule_GetPointer(capsule, kCapsuleName));
    managed->deleter(managed);
}

/// Returns a DLPack capsule, with which another library uses the memory of an array
/// without a copy. The memory stays valid until someone calls the deleter: the library,
/// or free_unused() if no library has used the capsule.
/// @param copy  None, or a bool: whether the user asks for a copy
py::object to_capsule(const py::object& object, const py::object& copy) {
    const auto& array = object.cast<const DeviceArray&>();
    const MemoryAddress address = array.buffer.address_for_others();
    // Memory that other libraries cannot use is copied to a numpy array.
    if (address.interface == MemoryAddress::Interface::none) return to_host(object).attr("__dlpack__")();
    if (!copy.is_none() && copy.cast<bool>())
        throw py::buffer_error("relidar.DeviceArray does not make copies; copy the tensor");
    // The deleter frees this object, possibly after the Python object is gone. DLPack
    // passes `managed` to the deleter, so `context` points back to this object.
    auto* exported = new ExportedTensor{.managed = {},
                                        .array = {array.device, array.buffer.share(), array.offset_bytes,
                                                  array.shape, array.strides, array.kind},
                                        .shape = {array.shape.begin(), array.shape.end()},
                                        .strides = {array.strides.begin(), array.strides.end()}};
    exported->managed = {
        .tensor = describe_tensor(*exported, address),
        .context = exported,
        .deleter = [](DLManagedTensor* managed) { delete static_cast<ExportedTensor*>(managed->context); }};
    PyObject* capsule = PyCapsule_New(&exported->managed, kCapsuleName, free_unused);
    return py::reinterpret_steal<py::object>(capsule);  // is the only reference to the capsule
}

std::string array_repr(const DeviceArray& array) {
    return fmt::format("<relidar.DeviceArray {}{}4 on {}>",
                       py::str(py::cast(array.shape)).cast<std::string>(), array.kind,
                       array.device->device.info().name);
}

}  // namespace

void bind_device_array(py::module_& module) {
    py::class_<DeviceArray>(
        module, "DeviceArray",
        "Numbers in the memory of a device, for numpy.from_dlpack(), torch.from_dlpack() and other users of "
        "DLPack. It keeps the memory and the device alive. relidar waits\n"
        "for its device before a call returns. Wait for other libraries on a GPU before the next call of "
        "relidar.")
        .def_property_readonly(
            "shape", [](const DeviceArray& array) { return py::tuple(py::cast(array.shape)); },
            "Tuple of lengths.")
        .def_property_readonly(
            "strides", [](const DeviceArray& array) { return py::tuple(py::cast(byte_strides(array))); },
            "Tuple of steps in bytes, like numpy's.")
        .def_property_readonly("dtype", &dtype_of, "float32, int32 or uint32.")
        .def_property_readonly(
            "is_shared",
            [](const DeviceArray& array) {
                return array.buffer.address_for_others().interface != MemoryAddress::Interface::none;
            },
            "True if tensors use the memory of the device. False if they are copies, so that changes need "
            "copy_from().")
        .def("numpy", &to_host,
             "Returns a numpy array: a view of the memory on a CPU device, otherwise a copy.")
        .def("copy_from", &copy_values, py::arg("values"),
             "Replaces all values by those of a numpy array, or of another object with __dlpack__ in host "
             "memory, of equal shape and dtype.")
        .def(
            "__dlpack__",
            [](const py::object& array, const py::object&, const py::object&, const py::object&,
               const py::object& copy) { return to_capsule(array, copy); },
            py::kw_only(), py::arg("stream") = py::none(), py::arg("max_version") = py::none(),
            py::arg("dl_device") = py::none(), py::arg("copy") = py::none(),
            "Returns a DLPack capsule of the memory. Without shared memory, the capsule has a copy in host "
            "memory.")
        .def(
            "__dlpack_device__",
            [](const DeviceArray& array) {
                const MemoryAddress address = array.buffer.address_for_others();
                return py::make_tuple(dlpack_type(address.interface), address.device_index);
            },
            "Returns the DLPack type and index of the device: (1, 0) host, (2, i) CUDA, (10, i) ROCm.")
        .def("__repr__", &array_repr);
}

}  // namespace relidar::python
