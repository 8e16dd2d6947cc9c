// SPDX-License-Identifier: Apache-2.0
// Draws the range, intensity and ray-drop of a scan as colour pictures.
#include <relidar/simulate/scan_files.hpp>

#include <cmath>

#include <relidar/simulate/render.hpp>

namespace relidar {

namespace {

// Ratio of width to height.
constexpr double kPictureAspect = 8.0;
constexpr float kMaxColourRange_m = 80.0f;
// Rays without image rows are drawn in lines of this length.
constexpr int kRaysPerLine = 2048;

/// Arranges the rays of a scan without image rows in lines. The last line ends with
/// dropped rays. The result has only the values that a picture shows.
RangeImage arrange_rows(const RangeImage& image) {
    RangeImage lines;
    lines.columns = kRaysPerLine;
    lines.rows = (image.columns + kRaysPerLine - 1) / kRaysPerLine;
    const std::size_t n_pixels = std::size_t(lines.rows) * std::size_t(lines.columns);
    lines.range_m = image.range_m;
    lines.range_m.resize(n_pixels, 0.0f);
    lines.intensity = image.intensity;
    lines.intensity.resize(n_pixels, 0.0f);
    lines.drop_prob = image.drop_prob;
    lines.drop_prob.resize(n_pixels, 1.0f);
    return lines;
}

}  // namespace

std::vector<float> return_mask(const RangeImage& image) {
    std::vector<float> mask(image.range_m.size());
    for (std::size_t i = 0; i < mask.size(); ++i)
        mask[i] = is_ray_returned(image.drop_prob[i], image.range_m[i]) ? 1.0f : 0.0f;
    return mask;
}

Image draw_range(const RangeImage& image, double max_range_m) {
    std::vector<float> square_roots = image.range_m;
    for (float& v : square_roots) v = std::sqrt(std::max(v, 0.0f));
    return apply_colour_map(square_roots, image.rows, image.columns, 0.0f,
                            static_cast<float>(std::sqrt(max_range_m)), "turbo", return_mask(image));
}

Image draw_intensity(const RangeImage& image) {
    return apply_colour_map(image.intensity, image.rows, image.columns, 0.0f, 1.0f, "gray",
                            return_mask(image));
}
Image draw_drop(const RangeImage& image) {
    return apply_colour_map(image.drop_prob, image.rows, image.columns, 0.0f, 1.0f, "gray");
}

int stretch_factor(const RangeImage& image) {
    return std::max(1, static_cast<int>(std::lround(image.columns / (kPictureAspect * image.rows))));
}

namespace {

Image draw_channels(const RangeImage& image) {
    float farthest = 1.0f;
    for (const float range : image.range_m) farthest = std::max(farthest, range);
    return stack_images({draw_range(image, static_cast<double>(std::min(farthest, kMaxColourRange_m))),
                         draw_intensity(image), draw_drop(image)},
                        stretch_factor(image));
}

}  // namespace

Image draw_scan(const RenderedScan& scan) {
    if (scan.image.rows == 1 && scan.image.columns > kRaysPerLine)
        return draw_channels(arrange_rows(scan.image));
    return draw_channels(scan.image);
}

}  // namespace relidar
