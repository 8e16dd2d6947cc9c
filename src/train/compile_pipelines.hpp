// SPDX-License-Identifier: Apache-2.0
// Compiles every kernel of the program, so that developers can inspect the result of a
// driver's compiler.
#pragma once

#include <functional>
#include <string>

namespace relidar {

class Device;

/// Compiles every pipeline that training and rendering use: those of each preset, and
/// those of each setting that changes a kernel, one at a time. Afterwards,
/// Device::pipelines() lists them.
/// @param device  opened with DeviceOptions::compile_only
/// @param progress  called with each preset or setting before it is compiled
void compile_pipelines(Device& device, const std::function<void(const std::string&)>& progress = {});

}  // namespace relidar
