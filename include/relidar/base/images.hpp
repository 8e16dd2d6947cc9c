// SPDX-License-Identifier: Apache-2.0
// Images, and the files that hold them: OpenEXR and PNG.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <relidar/base/files.hpp>

namespace relidar {

/// Float channels of one image, ZIP compressed. @param channels name -> [rows*columns]
/// @param notes string attributes
void write_exr(const std::filesystem::path& path, int rows, int columns,
               const std::map<std::string, std::vector<float>>& channels, const FileNotes& notes = {});
/// Channels of one image.
struct ExrImage {
    int rows = 0;
    int columns = 0;
    std::map<std::string, std::vector<float>> channels;  ///< name -> [rows*columns]
    std::map<std::string, std::string> notes;            ///< string attributes
};
/// Every channel of an OpenEXR image of scan lines, whatever its compression and type of
/// numbers. Sizes are checked against the file before anything is allocated. @throws
/// DataError for tiles, deep or several images, subsampled channels, absurd sizes, damage
ExrImage read_exr(const std::filesystem::path& path);

/// 8-bit RGB image.
struct Image {
    int rows = 0;
    int columns = 0;
    std::vector<std::uint8_t> rgb;  ///< [rows*columns*3]
};
/// Colour map of a scalar image: "turbo" (range), "gray" (intensity, drop), "heat"
/// (error). Values outside [low, high] clamp; NaN and pixels with mask 0 are dark gray.
/// @param mask [rows*columns] or empty
/// @throws UsageError for an unknown map, DataError for wrong counts or limits that are
/// not finite
Image colour_map(const std::vector<float>& values, int rows, int columns, float low, float high,
                 const std::string& map, const std::vector<float>& mask = {});
/// Stacks images of one width, separated by a thin line, each enlarged vertically by
/// `stretch` (a LiDAR row is taller than its column is wide). @throws DataError where
/// widths differ
Image stack(const std::vector<Image>& images, int stretch = 1);
/// PNG file, or its bytes. @param notes as international text (iTXt), names of 1 to 79
/// Latin letters
/// @throws DataError where rgb is not rows*columns*3 bytes, or nothing
void write_png(const std::filesystem::path& path, const Image& image, const FileNotes& notes = {});
std::vector<std::uint8_t> encode_png(const Image& image, const FileNotes& notes = {});

}  // namespace relidar
