// SPDX-License-Identifier: Apache-2.0
// Converts range images and other scalar images to colours, by linear interpolation
// between the colours below. "turbo" resembles the colour map Turbo: near is dark indigo,
// blue and cyan, then green and yellow, far is orange and dark red. "heat" is for errors.
#include <relidar/base/images.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "base/fail.hpp"

namespace relidar {
namespace {

using Colour = std::array<std::uint8_t, 3>;

constexpr std::array<Colour, 16> kTurboColours{{
    {38, 24, 84},
    {54, 50, 148},
    {62, 84, 204},
    {60, 120, 240},
    {46, 156, 246},
    {28, 190, 224},
    {30, 216, 184},
    {66, 234, 138},
    {120, 246, 92},
    {168, 246, 62},
    {210, 232, 50},
    {240, 202, 52},
    {248, 162, 46},
    {244, 114, 30},
    {216, 64, 16},
    {132, 12, 8},
}};
constexpr std::array<Colour, 2> kGrayColours{{{0, 0, 0}, {255, 255, 255}}};
constexpr std::array<Colour, 4> kHeatColours{{{0, 0, 0}, {210, 0, 0}, {255, 220, 0}, {255, 255, 255}}};
constexpr Colour kNoValue{44, 44, 48};        // Dark gray for pixels without a value.
constexpr std::uint8_t kSeparatorGray = 128;  // Gray value of the line between images.
constexpr int kSeparatorRows = 2;

/// Returns the interpolated colour at a position of a colour map.
/// @param stops colours of the map, evenly spaced
/// @param fraction position in the map, [0, 1]
Colour colour_at(std::span<const Colour> stops, double fraction) {
    const double position = fraction * double(stops.size() - 1);
    const std::size_t low = std::min(std::size_t(position), stops.size() - 2);
    const double share = position - double(low);
    Colour colour;
    for (std::size_t k = 0; k < 3; ++k)
        colour[k] = std::uint8_t(std::lround((1.0 - share) * stops[low][k] + share * stops[low + 1][k]));
    return colour;
}

void check_pixels(const char* name, std::size_t count, std::size_t expected_count) {
    if (count != expected_count)
        fail("cannot colour an image: {} has {} values, expected {} values, one for each pixel", name, count,
             expected_count);
}

}  // namespace

Image apply_colour_map(const std::vector<float>& values, int rows, int columns, float min_value,
                       float max_value, const std::string& colours, const std::vector<float>& valid) {
    const std::size_t n = std::size_t(std::max(rows, 0)) * std::size_t(std::max(columns, 0));
    check_pixels("the image", values.size(), n);
    if (!valid.empty()) check_pixels("the mask", valid.size(), n);
    if (!std::isfinite(min_value) || !std::isfinite(max_value))
        fail("cannot colour an image: the colour scale goes from {} to {}, expected finite limits", min_value,
             max_value);
    std::span<const Colour> stops;
    if (colours == "turbo") stops = kTurboColours;
    else if (colours == "gray") stops = kGrayColours;
    else if (colours == "heat") stops = kHeatColours;
    else fail<UsageError>("the colour map '{}' is unknown, expected turbo, gray or heat", colours);
    // Avoids a division by zero. A constant image gets the lowest colour.
    const double span = max_value > min_value ? double(max_value) - double(min_value) : 1.0;

    Image image{rows, columns, {}};
    image.rgb.reserve(n * 3);
    for (std::size_t i = 0; i < n; ++i) {
        const bool shown = !std::isnan(values[i]) && (valid.empty() || valid[i] != 0.0f);
        const Colour colour =
            shown ? colour_at(stops, std::clamp((double(values[i]) - double(min_value)) / span, 0.0, 1.0))
                  : kNoValue;
        image.rgb.insert(image.rgb.end(), colour.begin(), colour.end());
    }
    return image;
}

Image stack_images(const std::vector<Image>& images, int vertical_scale) {
    if (vertical_scale < 1)
        fail<UsageError>("cannot stack images: found the vertical scale {}, expected at least 1",
                         vertical_scale);
    Image result;
    for (const Image& image : images) {
        if (result.columns == 0) result.columns = image.columns;
        if (image.columns != result.columns)
            fail("cannot stack images: found the widths {} and {}, expected the same width", result.columns,
                 image.columns);
        const std::size_t width = std::size_t(image.columns) * 3;
        check_pixels("a stacked image", image.rgb.size(), width * std::size_t(image.rows));
        if (&image != &images.front()) {
            result.rgb.insert(result.rgb.end(), width * kSeparatorRows, kSeparatorGray);
            result.rows += kSeparatorRows;
        }
        for (std::size_t row = 0; row < std::size_t(image.rows); ++row)
            for (int copy = 0; copy < vertical_scale; ++copy) {
                const auto first = image.rgb.begin() + std::ptrdiff_t(row * width);
                result.rgb.insert(result.rgb.end(), first, first + std::ptrdiff_t(width));
            }
        result.rows += image.rows * vertical_scale;
    }
    return result;
}

}  // namespace relidar
