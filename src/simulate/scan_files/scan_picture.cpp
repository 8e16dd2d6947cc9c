// SPDX-License-Identifier: Apache-2.0
// Draws the range, intensity and ray-drop of a scan as colour pictures.
#include <relidar/simulate/scan_files.hpp>

#include <algorithm>
#include <cmath>

#include <relidar/simulate/render.hpp>

namespace relidar {

namespace {

// Ratio of width to height of each picture. The pictures are stacked.
constexpr double kPictureAspect = 8.0;
// Upper end of the colour scale in metres. All larger ranges have the same colour.
constexpr float kFarthest_m = 80.0f;

std::vector<float> roots(std::vector<float> values) {
    for (float& v : values) v = std::sqrt(std::max(v, 0.0f));
    return values;
}

}  // namespace

std::vector<float> returned_pixels(const RangeImage& image) {
    std::vector<float> mask(image.range_m.size());
    for (std::size_t i = 0; i < mask.size(); ++i)
        mask[i] = returned(image.drop_prob[i], image.range_m[i]) ? 1.0f : 0.0f;
    return mask;
}

Image range_picture(const RangeImage& image, double max_range_m) {
    return colour_map(roots(image.range_m), image.rows, image.columns, 0.0f,
                      static_cast<float>(std::sqrt(max_range_m)), "turbo", returned_pixels(image));
}

Image intensity_picture(const RangeImage& image) {
    return colour_map(image.intensity, image.rows, image.columns, 0.0f, 1.0f, "gray", returned_pixels(image));
}
Image drop_picture(const RangeImage& image) {
    return colour_map(image.drop_prob, image.rows, image.columns, 0.0f, 1.0f, "gray");
}

int picture_stretch(const RangeImage& image) {
    return std::max(1, static_cast<int>(std::lround(image.columns / (kPictureAspect * image.rows))));
}

Image scan_picture(const RenderedScan& scan) {
    const RangeImage& image = scan.image;
    float farthest = 1.0f;
    for (const float range : image.range_m) farthest = std::max(farthest, range);
    return stack({range_picture(image, static_cast<double>(std::min(farthest, kFarthest_m))),
                  intensity_picture(image), drop_picture(image)},
                 picture_stretch(image));
}

}  // namespace relidar
