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
    /// The caller must hold the GIL in the destructor.
    PythonLoss(SharedDevice device, PythonCallGuard& python_calls, py::function function)
        : device_(std::move(device)), python_calls_(python_calls), function_(std::move(function)) {}
    /// Waits for the device, because other libraries do not know its order of work. Then
    /// calls the function.
    /// @throws UsageError after an exception of the function, which `python_calls` stores
    void add_ray_losses(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                        const LossTermRow& terms) override;

private:
    SharedDevice device_;
    PythonCallGuard& python_calls_;
    py::function function_;

    void call_function(const RenderedBatch& rendered, const TargetBatch& targets,
                       const LossTermRow& terms) const;
};

}  // namespace relidar::python
