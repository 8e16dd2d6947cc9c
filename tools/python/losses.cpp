// SPDX-License-Identifier: Apache-2.0
// Losses of a training that are Python functions. They read the rendered and the measured
// values of a batch, and add to the gradients, in the memory of the device.
#include "losses.hpp"

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

/// Returns views of the rendered values of all rays of a batch: depth, weight and the
/// other blended values.
py::dict wrap_rendered(const SharedDevice& device, const RenderedBatch& rendered, std::size_t n_rays) {
    py::dict values;
#define RELIDAR_VALUES(name, ...) \
    values[#name] = wrap_member(device, *rendered.rendered, &shared::RenderedRay::name, n_rays);
    RELIDAR_BLENDED_VALUES(RELIDAR_VALUES)  // expands to one such line for each value
#undef RELIDAR_VALUES
    return values;
}

}  // namespace

void PythonLoss::add_ray_losses(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                                const LossTermRow& terms) {
    stream.submit_and_wait();
    const auto call = [&] {
        const UnlockedDevice unlocked(*device_);
        return python_calls_([&] { call_function(rendered, targets, terms); });
    };
    if (!call()) throw UsageError("training was stopped by an exception of a loss");
}

/// Calls the Python function with views of the arrays of a batch. relidar/_losses.py adds
/// its gradients to `upstream`, and its value to the term "custom" of the log.
void PythonLoss::call_function(const RenderedBatch& rendered, const TargetBatch& targets,
                               const LossTermRow& terms) const {
    using shared::DeviceRay, shared::DeviceTarget;
    // Views of one member of all targets, or of all rays.
    const auto target = [&](float DeviceTarget::*member) {
        return wrap_member(device_, *targets.targets, member, targets.n_rays, targets.first, targets.stride);
    };
    const auto ray = [&](auto member) {
        const RayBatch& batch = rendered.rays;
        return wrap_member(device_, *batch.rays, member, batch.n_rays, batch.first, batch.stride);
    };
    const py::dict measured(py::arg("range") = target(&DeviceTarget::range_m),
                            py::arg("intensity") = target(&DeviceTarget::intensity),
                            py::arg("weight") = target(&DeviceTarget::weight));
    const py::dict rays(py::arg("origins") = ray(&DeviceRay::origin),
                        py::arg("directions") = ray(&DeviceRay::direction),
                        py::arg("times") = ray(&DeviceRay::time_s));

    constexpr py::ssize_t kGradientFloats = sizeof(shared::RayGradient) / sizeof(float);
    const py::object upstream =
        py::cast(wrap_array<float>(device_, *rendered.upstream, {targets.n_rays, kGradientFloats}));
    // The log has a row of kLossTerms numbers for each iteration.
    const std::size_t term_index = terms.row * std::size_t(kLossTerms) + loss_term::custom;
    const py::object custom_term = py::cast(wrap_array<float>(device_, terms.terms, {1}, term_index));

    py::object shape = py::none();  // None: the rays are no image
    if (targets.image.is_image()) shape = py::make_tuple(targets.image.rows, targets.image.columns);
    py::module_::import("relidar._losses")
        .attr("call_loss")(function_, wrap_rendered(device_, rendered, targets.n_rays), measured, rays,
                           upstream, custom_term, py::arg("shape") = shape,
                           py::arg("n_returned") = targets.n_returned,
                           py::arg("n_known") = targets.n_known_rays);
}

}  // namespace relidar::python
