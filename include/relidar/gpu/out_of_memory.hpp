// SPDX-License-Identifier: Apache-2.0
// Error for exhausted device memory.
#pragma once

#include <relidar/base/error.hpp>

namespace relidar {

/// Error for an array that does not fit into the free device memory, or that is larger
/// than the device allows. The caller may catch the error and try a smaller array.
struct OutOfDeviceMemory : DeviceError {
    using DeviceError::DeviceError;
};

}  // namespace relidar
