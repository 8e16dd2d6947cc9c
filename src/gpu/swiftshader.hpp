// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/gpu/device.hpp>

namespace relidar::gpu {

/// Returns true if the driver is SwiftShader. Tracing kernels must not be compiled with
/// SwiftShader, because its compiler terminates the process (docs/debugging.md).
inline bool is_swiftshader(const DeviceInfo& info) { return info.driver.starts_with("SwiftShader"); }

}  // namespace relidar::gpu
