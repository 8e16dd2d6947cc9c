// SPDX-License-Identifier: Apache-2.0
// Short check of a device when it is used for the first time. The command `relidar check`
// is the long check.
#pragma once

#include <relidar/gpu/trust.hpp>

namespace relidar {

/// Checks float atomics, compare-and-swap sums and subgroups. Also checks ray queries if
/// the options select them. Pass this function to set_open_callbacks(). The check
/// takes about a second.
/// @return results of the check
/// @throws DeviceError if no subgroup size gives right results
DeviceTestResults test_device(const DeviceOptions& options);

/// State of the trees of an acceleration structure.
enum class AccelTreeState { built, refitted };

/// Renders a small scene twice: with the traversal of the device, and with a search of
/// all surfels.
/// @return the number of rays, out of 256, for which the two renderings have different
/// hits
int count_wrong_rays(Device& device, AccelTreeState tree_state = AccelTreeState::built);

}  // namespace relidar
