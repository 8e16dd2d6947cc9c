// SPDX-License-Identifier: Apache-2.0
// What an asset looks like from all sides.
#pragma once

#include <relidar/base/images.hpp>
#include <relidar/simulate/assets.hpp>

namespace relidar::cli {

/// From the left, the right and above, and below these from behind and from the front:
/// parallel rays every 2 cm (more for what is longer than 8 m), bright where it is bright
/// to the LiDAR, shaded by how steeply it is met; bluish what the mirror image stands in
/// for.
Image asset_picture(Device& device, const Asset& asset, const BoxSurface& surface);

}  // namespace relidar::cli
