// SPDX-License-Identifier: Apache-2.0
// Explains why installed Vulkan drivers are not available.
#pragma once

#include <string>
#include <vector>

namespace relidar::gpu {

/// Returns a text for each driver manifest that cannot be read, or whose library cannot
/// be loaded. Reads the manifests that the user selects, or those of the system.
std::vector<std::string> find_broken_drivers();

}  // namespace relidar::gpu
