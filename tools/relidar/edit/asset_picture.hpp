// SPDX-License-Identifier: Apache-2.0
// Renders pictures of an asset from five sides.
#pragma once

#include <relidar/base/images.hpp>
#include <relidar/simulate/assets.hpp>

namespace relidar::cli {

/// Renders an asset with parallel rays. The upper row shows it from the left, the right
/// and above. The lower row shows it from behind and from the front. The rays are 2 cm
/// apart, or more if the asset is longer than 8 m. The brightness is the LiDAR intensity,
/// reduced by the angle between ray and surface. Bluish parts were not seen, but copied
/// from the other side by mirroring.
Image asset_picture(Device& device, const Asset& asset, const BoxSurface& surface);

}  // namespace relidar::cli
