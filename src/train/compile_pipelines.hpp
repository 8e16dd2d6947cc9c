// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>

namespace relidar {

class Device;

/// Compiles every pipeline that training and rendering use, which Device::pipelines()
/// then lists.
/// @param device  must be opened with DeviceOptions::compile_only
void compile_pipelines(Device& device, const std::function<void(const std::string&)>& progress = {});

}  // namespace relidar
