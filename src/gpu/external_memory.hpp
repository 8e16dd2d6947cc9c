// SPDX-License-Identifier: Apache-2.0
// Shares device memory with CUDA or HIP. Their driver libraries are loaded only if a
// card of their vendor is used, so relidar does not depend on them.
#pragma once

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Returns true if CUDA or HIP can import buffers of the device.
/// @param binds_sparse true if buffers with sparse binding must be importable as well
bool can_export(VkPhysicalDevice physical, bool binds_sparse);

/// Exports a block as a file descriptor, which the caller must close.
/// @throws DeviceError if the driver refuses
int export_block(const Device::Impl& device, const MemoryBlock& block);

/// Returns the address of a block in CUDA (NVIDIA) or HIP (AMD). Only the first call for
/// a block imports it. Without their library or with another vendor, the interface is
/// `none`.
/// @throws DeviceError if the library does not list the card, or cannot import the memory
MemoryAddress import_block(const Device::Impl& device, MemoryBlock& block);

}  // namespace relidar::gpu
