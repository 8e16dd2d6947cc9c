// SPDX-License-Identifier: Apache-2.0
// Points as people's files hold them: PCD, PLY, .bin, .npy. Each format says where its
// fields lie; the rest is the same for all.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::folder {

/// Whether relidar reads a field of this name. Others, colours and normals for instance,
/// are not kept.
bool is_point_field(std::string_view name);

/// Fields of the points by name, those that relidar knows.
struct PointTable {
    std::size_t n = 0;
    std::map<std::string, std::vector<double>> fields;  ///< [n] each
    bool is_deskewed = false;  ///< the file says that its points are deskewed or in the world

    /// Values of the first of these names that is there, nullptr where none is.
    const std::vector<double>* find(std::initializer_list<const char*> names) const;
};

/// A field of a record.
struct PointField {
    std::string name;
    char kind;         ///< 'F' floating, 'I' signed, 'U' unsigned
    std::size_t size;  ///< bytes of a number
    std::size_t count = 1;
};

/// How the numbers of n points lie in bytes.
enum class Packing {
    by_point,  ///< a record a point
    by_field   ///< all values of the first field, then all of the second
};

/// Fields of packed numbers, little-endian. @throws DataError for kinds and sizes there
/// are no numbers of, or too few bytes
PointTable read_packed(std::string_view bytes, const std::vector<PointField>& fields, std::size_t n,
                       Packing packing, const std::string& where);
/// Fields of n lines of numbers parted by blanks.
PointTable read_lines(std::string_view text, const std::vector<PointField>& fields, std::size_t n,
                      const std::string& where);

/// Whether a file's ending is that of one of the formats.
bool is_point_file(const std::filesystem::path& file);
/// Whether a file's ending is that of images, which hold a ray each pixel.
bool is_image_file(const std::filesystem::path& file);
/// Points of a file, its format by its ending. @param columns  fields of .bin and .npy;
/// empty: x y z intensity
/// @throws DataError naming the file
PointTable read_point_file(const std::filesystem::path& file, const std::vector<std::string>& columns);

/// The two formats with headers; point_pcd.cpp, point_ply.cpp.
PointTable read_pcd(const std::string& bytes, const std::string& where);
PointTable read_ply(const std::string& bytes, const std::string& where);

}  // namespace relidar::folder
