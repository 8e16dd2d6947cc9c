// SPDX-License-Identifier: Apache-2.0
// Converts range images and other scalar images to colours, by linear interpolation
// between the colours below. "turbo" resembles the colour map Turbo: near is dark indigo,
// blue and cyan, then green and yellow, far is orange and dark red. "heat" is for errors.
//
// Writes 8-bit RGB images as PNG files. Uses the simplified interface of libpng, because
// it reports failures by return values instead of longjmp.
#include <relidar/base/images.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include <png.h>
#include <zlib.h>

#include "base/fail.hpp"
#include "file_io.hpp"

namespace relidar {
namespace {

using Colour = std::array<std::uint8_t, 3>;

// Colours as 0xRRGGBB.
constexpr std::uint32_t kTurboColours[] = {0x261854, 0x363294, 0x3e54cc, 0x3c78f0, 0x2e9cf6, 0x1cbee0,
                                           0x1ed8b8, 0x42ea8a, 0x78f65c, 0xa8f63e, 0xd2e832, 0xf0ca34,
                                           0xf8a22e, 0xf4721e, 0xd84010, 0x840c08};
constexpr std::uint32_t kGrayColours[] = {0x000000, 0xffffff};
constexpr std::uint32_t kHeatColours[] = {0x000000, 0xd20000, 0xffdc00, 0xffffff};
constexpr Colour kNoValue{44, 44, 48};        // Dark gray for pixels without a value.
constexpr std::uint8_t kSeparatorGray = 128;  // Gray value of the line between images.
constexpr int kSeparatorRows = 2;

/// Returns the interpolated colour at a position of a colour map.
/// @param stops colours of the map, evenly spaced
/// @param fraction position in the map, [0, 1]
Colour colour_at(std::span<const std::uint32_t> stops, double fraction) {
    const double position = fraction * double(stops.size() - 1);
    const std::size_t low = std::min(std::size_t(position), stops.size() - 2);
    const double share = position - double(low);
    Colour colour;
    for (std::size_t k = 0; k < 3; ++k) {
        // Red, green or blue of a colour 0xRRGGBB.
        const auto channel = [&](std::uint32_t stop) { return stop >> (16 - 8 * k) & 0xFF; };
        const double value = (1.0 - share) * channel(stops[low]) + share * channel(stops[low + 1]);
        colour[k] = std::uint8_t(std::lround(value));
    }
    return colour;
}

void check_pixels(const char* name, std::size_t count, std::size_t expected_count) {
    if (count != expected_count)
        fail("cannot colour an image: {} has {} values, expected {} values, one for each pixel", name, count,
             expected_count);
}

void append_be32(std::string& bytes, std::uint32_t value) {
    for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(value >> shift);
}

/// Returns a PNG text chunk (iTXt) with a name and an uncompressed UTF-8 text: length of
/// the content, type, content, checksum of type and content. We write this chunk
/// ourselves, because the simplified interface of libpng cannot write text.
std::string make_text_chunk(const std::string& keyword, const std::string& text) {
    constexpr std::string_view kChunkType = "iTXt";
    // Zero bytes: end of the name, not compressed, method 0, no language or translation.
    const std::string body = std::string(kChunkType) + keyword + std::string(5, '\0') + text;
    const auto checksum =
        crc32(0, reinterpret_cast<const Bytef*>(body.data()), static_cast<uInt>(body.size()));
    std::string chunk;
    append_be32(chunk, static_cast<std::uint32_t>(body.size() - kChunkType.size()));
    chunk += body;
    append_be32(chunk, static_cast<std::uint32_t>(checksum));
    return chunk;
}

// Size of the PNG signature (8) and the IHDR chunk (25).
constexpr std::ptrdiff_t kAfterHeader = 8 + 25;

}  // namespace

Image apply_colour_map(const std::vector<float>& values, int rows, int columns, float min_value,
                       float max_value, const std::string& colours, const std::vector<float>& valid) {
    const std::size_t n = std::size_t(std::max(rows, 0)) * std::size_t(std::max(columns, 0));
    check_pixels("the image", values.size(), n);
    if (!valid.empty()) check_pixels("the mask", valid.size(), n);
    if (!std::isfinite(min_value) || !std::isfinite(max_value))
        fail("cannot colour an image: the colour scale goes from {} to {}, expected finite limits", min_value,
             max_value);
    std::span<const std::uint32_t> stops;
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
        const std::size_t row_bytes = std::size_t(image.columns) * 3;
        check_pixels("a stacked image", image.rgb.size(), row_bytes * std::size_t(image.rows));
        if (&image != &images.front()) {
            result.rgb.insert(result.rgb.end(), row_bytes * kSeparatorRows, kSeparatorGray);
            result.rows += kSeparatorRows;
        }
        for (std::size_t row = 0; row < std::size_t(image.rows); ++row)
            for (int copy = 0; copy < vertical_scale; ++copy) {
                const auto row_begin = image.rgb.begin() + std::ptrdiff_t(row * row_bytes);
                result.rgb.insert(result.rgb.end(), row_begin, row_begin + std::ptrdiff_t(row_bytes));
            }
        result.rows += image.rows * vertical_scale;
    }
    return result;
}

namespace {

/// Encodes an image with libpng, then inserts a text chunk per entry of the metadata.
/// @param png_format  PNG_FORMAT_*, which decides the type of the values
template <class T>
std::vector<std::uint8_t> encode_pixels(int rows, int columns, std::span<const T> values,
                                        std::uint32_t png_format, const FileMetadata& metadata) {
    const std::size_t n = std::size_t(std::max(rows, 0)) * std::size_t(std::max(columns, 0)) *
                          PNG_IMAGE_SAMPLE_CHANNELS(png_format);
    if (n == 0 || values.size() != n)
        fail("cannot encode a PNG image of {} x {} pixels: found {} values, expected {}", rows, columns,
             values.size(), n);
    png_image description{};
    description.version = PNG_IMAGE_VERSION;
    description.width = png_uint_32(columns);
    description.height = png_uint_32(rows);
    description.format = png_format;
    png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(description);
    std::vector<std::uint8_t> bytes(size);
    const int succeeded =
        png_image_write_to_memory(&description, bytes.data(), &size, 0, values.data(), 0, nullptr);
    const std::string message = description.message;
    png_image_free(&description);
    if (!succeeded) throw DataError("cannot encode a PNG image: " + message);
    bytes.resize(size);
    std::string chunks;
    for (const auto& [name, text] : metadata) chunks += make_text_chunk(name, text);
    bytes.insert(bytes.begin() + kAfterHeader, chunks.begin(), chunks.end());
    return bytes;
}

void write_bytes(const std::filesystem::path& path, const std::vector<std::uint8_t>& bytes) {
    codecs::write_file(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace

std::vector<std::uint8_t> encode_png(const Image& image, const FileMetadata& metadata) {
    return encode_pixels<std::uint8_t>(image.rows, image.columns, image.rgb, PNG_FORMAT_RGB, metadata);
}

std::vector<std::uint8_t> encode_png(const DepthImage& image, const FileMetadata& metadata) {
    // libpng stores values of a linear format unchanged.
    return encode_pixels<std::uint16_t>(image.rows, image.columns, image.values, PNG_FORMAT_LINEAR_Y,
                                        metadata);
}

void write_png(const std::filesystem::path& path, const Image& image, const FileMetadata& metadata) {
    write_bytes(path, encode_png(image, metadata));
}

void write_png(const std::filesystem::path& path, const DepthImage& image, const FileMetadata& metadata) {
    write_bytes(path, encode_png(image, metadata));
}

}  // namespace relidar
