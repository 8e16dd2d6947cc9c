// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>

namespace relidar {

class Device;

/// Compiles every pipeline that training and rendering use: the kernels of each preset,
/// and of each setting that changes a kernel. Afterwards, Device::pipelines() lists the
/// pipelines.
/// @param device  must be opened with DeviceOptions::compile_only
/// @param report_progress  called with the name of a preset or setting before it is
/// compiled
void compile_all_pipelines(Device& device,
                           const std::function<void(const std::string&)>& report_progress = {});

}  // namespace relidar
