// SPDX-License-Identifier: Apache-2.0
// Short check of a device at its first use. `relidar check` is the long check.
#pragma once

#include <relidar/gpu/trust.hpp>

namespace relidar {

/// Checks float atomics, compare-and-swap sums, subgroups, and ray queries if the options
/// select them. Use this function in set_first_use(). It takes about a second.
/// @return results of the check
/// @throws DeviceError if no subgroup size gives right results
DeviceTrust check_first_use(const DeviceOptions& options);

/// State of the trees of an acceleration structure.
enum class TreeState { built, refitted };

/// Renders a small scene twice, with the traversal of the device and with a search of all
/// surfels.
/// @return the number of rays, of 256, whose hits differ
int count_wrong_rays(Device& device, TreeState state = TreeState::built);

}  // namespace relidar
