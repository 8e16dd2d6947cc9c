// SPDX-License-Identifier: Apache-2.0
// Losses of a training that are Python functions. They read the rendered and the measured
// values of a batch, and add to the gradients, in the memory of the device.
#include "losses.hpp"

#include <cstddef>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/traversal.hpp>
#include "device_array.hpp"

namespace relidar::python {
namespace {

/// Lets this thread and other threads use the device of a training that waits for a
/// Python function. The stream of the training must be idle.
class UnlockedDevice {
public:
    explicit UnlockedDevice(LockableDevice& device) : device_(device), user_(device.user) {
        device_.user = std::thread::id();
        device_.in_use.unlock();
    }
    ~UnlockedDevice() {
        device_.in_use.lock();
        device_.user = user_;
    }
    UnlockedDevice(const UnlockedDevice&) = delete;
    UnlockedDevice& operator=(const UnlockedDevice&) = delete;

private:
    LockableDevice& device_;
    std::thread::id user_;
};

/// Wraps a member of the structs first, first + stride, ... of a device array.
template <class Batch, class T>
DeviceArray wrap_rows(const SharedDevice& device, const Batch& batch, const Array<T>& array,
                      std::size_t member_bytes, py::ssize_t width = 0) {
    DeviceArray rows =
        wrap_member<float>(device, array, batch.first * sizeof(T) + member_bytes, batch.n_rays, width);
    rows.strides[0] *= batch.stride;
    return rows;
}

}  // namespace

PythonLoss::PythonLoss(SharedDevice device, PythonCallGuard& python_calls, py::function function)
    : device_(std::move(device)), python_calls_(python_calls), function_(std::move(function)) {
    try {
        torch_ = py::module_::import("torch");
        tensors_ = py::module_::import("relidar.torch");
    } catch (const py::error_already_set& error) {
        if (!error.matches(PyExc_ModuleNotFoundError)) throw;
    }
}

py::object PythonLoss::to_tensor(const py::object& array) const {
    return torch_ ? tensors_.attr("_read")(array) : array.attr("numpy")();
}

void PythonLoss::add_ray_losses(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                                const LossTermRow& terms) {
    stream.submit_and_wait();
    const auto call = [&] {
        const UnlockedDevice unlocked(*device_);
        return python_calls_([&] { call_function(rendered, targets, terms); });
    };
    if (!call()) throw UsageError("training was stopped by an exception of a loss");
}

/// Returns the object that the function gets.
/// @param d_rendered tensor of the gradients, [n, floats of RayGradient]
py::object PythonLoss::make_batch(const RenderedBatch& rendered, const TargetBatch& targets,
                                  const py::object& d_rendered) const {
    using shared::DeviceRay, shared::DeviceTarget, shared::RayGradient, shared::RenderedRay;
    const auto wrap = [&](const auto& rows, const auto& array, std::size_t member_bytes,
                          py::ssize_t width = 0) {
        return to_tensor(py::cast(wrap_rows(device_, rows, array, member_bytes, width)));
    };
    py::dict values, gradients;
#define RELIDAR_VALUES(name, built, value, input, slope, meaning)                                       \
    values[#name] = to_tensor(py::cast(                                                                 \
        wrap_member<float>(device_, *rendered.rendered, offsetof(RenderedRay, name), targets.n_rays))); \
    gradients[#name] = d_rendered.attr("T")[py::int_(offsetof(RayGradient, name) / sizeof(float))];
    RELIDAR_BLENDED_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
    if (torch_)
        for (const auto& [name, tensor] : values) tensor.attr("requires_grad_")();
    const Array<DeviceTarget>& measured = *targets.targets;
    const RayBatch& rays = rendered.rays;
    py::object shape = py::none();
    if (targets.image.is_image()) shape = py::make_tuple(targets.image.rows, targets.image.columns);
    return py::module_::import("types").attr("SimpleNamespace")(
        py::arg("rendered") = values, py::arg("gradients") = gradients,
        py::arg("measured") =
            py::dict(py::arg("range") = wrap(targets, measured, offsetof(DeviceTarget, range_m)),
                     py::arg("intensity") = wrap(targets, measured, offsetof(DeviceTarget, intensity)),
                     py::arg("weight") = wrap(targets, measured, offsetof(DeviceTarget, weight))),
        py::arg("rays") =
            py::dict(py::arg("origins") = wrap(rays, *rays.rays, offsetof(DeviceRay, origin), 3),
                     py::arg("directions") = wrap(rays, *rays.rays, offsetof(DeviceRay, direction), 3),
                     py::arg("times") = wrap(rays, *rays.rays, offsetof(DeviceRay, time_s))),
        py::arg("shape") = shape, py::arg("n_returned") = targets.n_returned,
        py::arg("n_known") = targets.n_known_rays);
}

/// Calls the function with the tensors of a batch, and adds its gradients and its value.
void PythonLoss::call_function(const RenderedBatch& rendered, const TargetBatch& targets,
                               const LossTermRow& terms) const {
    constexpr py::ssize_t kFloats = sizeof(shared::RayGradient) / sizeof(float);
    const py::object upstream =
                         py::cast(wrap_array<float>(device_, *rendered.upstream, {targets.n_rays, kFloats})),
                     term = py::cast(wrap_array<float>(
                         device_, terms.terms, {1}, terms.row * std::size_t(kLossTerms) + loss_term::custom));
    const py::object d_rendered = to_tensor(upstream), sum = to_tensor(term),
                     batch = make_batch(rendered, targets, d_rendered);
    const py::list values(batch.attr("rendered").attr("values")()),
        gradients(batch.attr("gradients").attr("values")());
    py::object result = function_(batch);
    if (torch_ && py::isinstance(result, torch_.attr("Tensor"))) {
        if (!result.attr("requires_grad").cast<bool>() || result.attr("numel")().cast<int>() != 1)
            throw UsageError(fmt::format(
                "train: a loss returned a tensor of shape {}, requires_grad={}; expected one number that "
                "depends on batch.rendered, or a float after adding to batch.gradients",
                py::str(result.attr("shape")).cast<std::string>(),
                result.attr("requires_grad").cast<bool>()));
        result.attr("backward")();
        for (std::size_t i = 0; i < values.size(); ++i)
            if (const py::object d = values[i].attr("grad"); !d.is_none()) gradients[i].attr("add_")(d);
        result = result.attr("detach")().attr("reshape")(1);
    } else {
        const double number = PyFloat_AsDouble(result.ptr());
        if (PyErr_Occurred()) {
            PyErr_Clear();
            throw UsageError(fmt::format("train: a loss returned {}, expected a torch tensor or a float",
                                         py::str(py::type::of(result)).cast<std::string>()));
        }
        result = py::float_(number);
    }
    sum.attr("__iadd__")(result);
    if (torch_ && sum.attr("is_cuda").cast<bool>()) torch_.attr("cuda").attr("synchronize")();
    for (const auto& [array, tensor] : {std::pair(upstream, d_rendered), std::pair(term, sum)})
        if (!(torch_ ? tensors_.attr("_is_shared")(array) : array.attr("is_shared")).cast<bool>())
            array.attr("copy_from")(tensor);
}

}  // namespace relidar::python
