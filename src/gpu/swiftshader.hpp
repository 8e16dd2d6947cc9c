// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/gpu/device.hpp>

namespace relidar::gpu {

/// SwiftShader's compiler ends the process on kernels that trace (docs/debugging.md).
inline bool is_swiftshader(const DeviceInfo& info) { return info.driver.starts_with("SwiftShader"); }

}  // namespace relidar::gpu
