// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/base/images.hpp>
#include <relidar/simulate/assets.hpp>

namespace relidar::cli {

/// Renders pictures of an asset with parallel rays. The upper row shows the left, right
/// and top sides. The lower row shows the back and the front. The rays are 2 cm apart, or
/// more if the asset is longer than 8 m. A pixel is brighter if its intensity is higher,
/// and darker if the ray meets the surface at a flat angle. Bluish parts were not
/// observed. They are mirrored copies of the other side.
Image draw_asset(Device& device, const ActorAsset& asset, const ObservedBoxSurface& surface);

}  // namespace relidar::cli
