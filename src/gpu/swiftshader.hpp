// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/gpu/device.hpp>

namespace relidar::gpu {

/// Returns true if the driver is SwiftShader. Its compiler terminates the process when it
/// compiles tracing kernels (docs/debugging.md).
inline bool is_swiftshader(const DeviceInfo& info) { return info.driver.starts_with("SwiftShader"); }

}  // namespace relidar::gpu
