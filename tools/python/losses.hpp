// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/diff/loss.hpp>
#include "calls.hpp"
#include "device.hpp"

namespace relidar::python {

/// Loss that a Python function computes: with torch as a tensor, whose gradient autograd
/// computes, otherwise as a number after adding to the gradients.
class PythonLoss final : public Loss {
public:
    /// The caller must hold the GIL, here and in the destructor.
    PythonLoss(SharedDevice device, PythonCallGuard& python_calls, py::function function);
    /// Waits for the device, because other libraries do not know its order of work. Then
    /// calls the function.
    /// @throws UsageError after an exception of the function, which `python_calls` stores
    void add_ray_losses(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                        const LossTermRow& terms) override;

private:
    SharedDevice device_;
    PythonCallGuard& python_calls_;
    py::function function_;
    py::object torch_, tensors_;  ///< the modules torch and relidar.torch, null without torch

    py::object to_tensor(const py::object& array) const;
    py::object make_batch(const RenderedBatch& rendered, const TargetBatch& targets,
                          const py::object& d_rendered) const;
    void call_function(const RenderedBatch& rendered, const TargetBatch& targets,
                       const LossTermRow& terms) const;
};

}  // namespace relidar::python
