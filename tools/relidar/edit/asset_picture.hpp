// SPDX-License-Identifier: Apache-2.0
// Renders pictures of an asset from five sides.
#pragma once

#include <relidar/base/images.hpp>
#include <relidar/simulate/assets.hpp>

namespace relidar::cli {

/// Renders an asset with parallel rays. The upper row shows it from the left, the right
/// and above, the lower row from behind and from the front. Rays are 2 cm apart, or more
/// for objects longer than 8 m. Brightness is the LiDAR intensity, shaded by the angle
/// between ray and surface. Bluish parts were completed by the mirror image of the other
/// side.
Image asset_picture(Device& device, const Asset& asset, const BoxSurface& surface);

}  // namespace relidar::cli
