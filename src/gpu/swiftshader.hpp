// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/gpu/device.hpp>

namespace relidar::gpu {

/// Its compiler terminates the process on tracing kernels (docs/debugging.md).
inline bool is_swiftshader(const DeviceInfo& info) { return info.driver.starts_with("SwiftShader"); }

}  // namespace relidar::gpu
