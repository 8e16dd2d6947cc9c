// SPDX-License-Identifier: Apache-2.0
// Reads and writes images as OpenEXR and PNG files.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <relidar/base/files.hpp>

namespace relidar {

/// Writes the float channels of an image to a ZIP-compressed OpenEXR file.
/// @param channels map from channel name to values [rows*columns]
/// @param metadata string attributes of the file
void write_exr(const std::filesystem::path& path, int rows, int columns,
               const std::map<std::string, std::vector<float>>& channels, const FileMetadata& metadata = {});
/// Channels and attributes of an OpenEXR image.
struct ExrImage {
    int rows = 0;
    int columns = 0;
    /// Map from channel name to values [rows*columns].
    std::map<std::string, std::vector<float>> channels;
    std::map<std::string, std::string> notes;  ///< String attributes of the file.
};
/// Reads all channels of an OpenEXR scan-line image, with any compression and any number
/// type. Compares the image size with the file size before allocating memory, so that a
/// damaged file cannot exhaust the memory.
/// @throws DataError if the file has tiles, deep data, several images, subsampled
/// channels or unreasonable sizes, or is damaged
ExrImage read_exr(const std::filesystem::path& path);

/// 8-bit RGB image.
struct Image {
    int rows = 0;
    int columns = 0;
    std::vector<std::uint8_t> rgb;  ///< Pixel values, [rows*columns*3].
};
/// 16-bit gray image.
struct DepthImage {
    int rows = 0;
    int columns = 0;
    std::vector<std::uint16_t> values;  ///< [rows*columns]
};
/// Converts an image of scalar values to colours. The colour map is "turbo" (range),
/// "gray" (intensity, drop) or "heat" (error). Values outside [low, high] are clamped.
/// NaN values and pixels with mask 0 become dark gray.
/// @param valid [rows*columns] or empty
/// @throws UsageError for an unknown colour map
/// @throws DataError for wrong counts or limits that are not finite
Image apply_colour_map(const std::vector<float>& values, int rows, int columns, float min_value,
                       float max_value, const std::string& colours, const std::vector<float>& valid = {});
/// Stacks images of equal width vertically, separated by a thin line.
/// @param vertical_scale vertical magnification of each image, because a LiDAR row covers
/// a larger angle than a column
/// @throws UsageError if `vertical_scale` is below 1
/// @throws DataError if the widths differ
Image stack_images(const std::vector<Image>& images, int vertical_scale = 1);
/// Writes an image as a PNG file. encode_png() does not write a file, but returns the
/// bytes.
/// @param metadata stored as international text (iTXt). A name has 1 to 79 Latin letters.
/// @throws DataError if the image is empty or has a wrong number of values
void write_png(const std::filesystem::path& path, const Image& image, const FileMetadata& metadata = {});
void write_png(const std::filesystem::path& path, const DepthImage& image, const FileMetadata& metadata = {});
std::vector<std::uint8_t> encode_png(const Image& image, const FileMetadata& metadata = {});
std::vector<std::uint8_t> encode_png(const DepthImage& image, const FileMetadata& metadata = {});

}  // namespace relidar
