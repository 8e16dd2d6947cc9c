// SPDX-License-Identifier: Apache-2.0
// Table of the points in a user's file (PCD, PLY, .bin or .npy). The reader of a format
// describes only the layout of the fields. Values are not copied and keep the number type
// of the file.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/codecs/npy.hpp"

namespace relidar::read {

enum class PointAttribute { x, y, z, intensity, ring, time, return_number, return_type, range };

/// Returns the meaning of a field by its name. Ignores upper case and prefixes such as
/// "scalar_". Returns nothing for fields that relidar does not read, such as colours.
std::optional<PointAttribute> find_attribute(std::string_view field_name);
inline bool is_known_field(std::string_view field_name) { return find_attribute(field_name).has_value(); }

enum class ScalarType : std::uint8_t { f4, f8, i1, i2, i4, i8, u1, u2, u4, u8 };

/// Values of one field for all points of a cloud, in the number type of the file.
class PointFieldView {
    // Must precede its uses, so that older versions of clang can deduce the return type.
    template <class T>
    auto value_reader() const {
        return [first = first_, step = step_](std::size_t index) {
            T value;
            std::memcpy(&value, first + index * step, sizeof value);
            return value;
        };
    }

public:
    /// @param step  number of bytes between the values of two consecutive points
    PointFieldView(ScalarType type, const char* first, std::size_t step)
        : first_(first), step_(step), type_(type) {}

    /// Calls callback(value_at); value_at(i) returns the value of point i in the type of
    /// the file.
    template <class Callback>
    void with_reader(const Callback& callback) const {
        switch (type_) {
            case ScalarType::f4: return callback(value_reader<float>());
            case ScalarType::f8: return callback(value_reader<double>());
            case ScalarType::i1: return callback(value_reader<std::int8_t>());
            case ScalarType::i2: return callback(value_reader<std::int16_t>());
            case ScalarType::i4: return callback(value_reader<std::int32_t>());
            case ScalarType::i8: return callback(value_reader<std::int64_t>());
            case ScalarType::u1: return callback(value_reader<std::uint8_t>());
            case ScalarType::u2: return callback(value_reader<std::uint16_t>());
            case ScalarType::u4: return callback(value_reader<std::uint32_t>());
            case ScalarType::u8: return callback(value_reader<std::uint64_t>());
        }
    }
    /// Calls visit(i, value) for the first n points.
    template <class Visit>
    void for_each(std::size_t n, const Visit& visit) const {
        with_reader([&](const auto& value_at) {
            for (std::size_t i = 0; i < n; ++i) visit(i, double(value_at(i)));
        });
    }
    /// Returns one value. To read many values, for_each() is faster.
    double operator[](std::size_t index) const {
        double value = 0.0;
        with_reader([&](const auto& value_at) { value = double(value_at(index)); });
        return value;
    }

private:
    const char* first_;
    std::size_t step_;
    ScalarType type_;
};

/// A point cloud with an array per field. Copies share the memory of the values.
class PointTable {
public:
    explicit PointTable(std::size_t n_points = 0) : n(n_points) {}

    std::size_t n;  ///< number of points
    /// True if the file says that its points are motion-compensated or in the world
    /// frame.
    bool is_deskewed = false;
    std::vector<std::string> unread;  ///< names of the fields that relidar does not read

    /// Returns the field with a meaning such as "intensity", or null if no field has this
    /// meaning. If several fields match, the order in the list of known names decides.
    const PointFieldView* find_field(PointAttribute attribute) const;
    const PointFieldView* find_field(const std::string& field_name) const;
    /// Returns the names of all fields with a meaning, in the order of the list of known
    /// names.
    std::vector<std::string> list_fields(PointAttribute attribute) const;
    /// Adds a field to the table.
    /// @param where  name of the file, for error messages
    /// @throws DataError if the field already exists
    void add_value_field(const std::string& name, const PointFieldView& values, const std::string& where);
    template <class T>
    void add_value_field(const std::string& field_name, ScalarType type, std::vector<T> values,
                         const std::string& where) {
        const auto memory = std::make_shared<const std::vector<T>>(std::move(values));
        keep_alive(memory);
        add_value_field(field_name, {type, reinterpret_cast<const char*>(memory->data()), sizeof(T)}, where);
    }
    void remove_fields(PointAttribute attribute);
    /// Keeps the memory of field values allocated as long as the table exists.
    void keep_alive(std::shared_ptr<const void> memory) { memory_.push_back(std::move(memory)); }

private:
    std::map<std::string, PointFieldView> fields_;
    std::vector<std::shared_ptr<const void>> memory_;
};

/// Name of fields that only fill gaps between other fields.
inline constexpr std::string_view kPaddingName = "_";

struct PointField {
    std::string name;
    char kind;         ///< 'F' means floating point, 'I' signed integer, 'U' unsigned integer
    std::size_t size;  ///< bytes per number
    std::size_t count = 1;
};

/// Whether values are stored point by point, or field by field.
enum class PointMemoryLayout {
    by_point,  ///< one record per point
    by_field   ///< all values of the first field, followed by all values of the second field, and so on
};

/// Maximum number of fields of a point. A larger number is damage.
inline constexpr std::size_t kMostFields = 1024;
/// Checks the number of points of a file.
/// @throws DataError if there are no points, or too many for one scan
void check_point_count(std::size_t n_points, const std::string& where);
/// Returns a table of binary little-endian numbers, without copying them.
/// @throws DataError if a number type does not exist or if the data is too short
PointTable table_of_records(const SharedBytes& data, const std::vector<PointField>& fields,
                            std::size_t n_points, PointMemoryLayout memory_layout, const std::string& where);
/// Splits a line at blanks and tabs.
std::vector<std::string_view> split_words(std::string_view line);
/// Parses `n_points` lines of numbers that are separated by blanks, one line per point.
PointTable parse_lines(std::string_view text, const std::vector<PointField>& fields, std::size_t n_points,
                       const std::string& where);

bool is_point_file(const std::filesystem::path& file);
/// Returns true if each pixel of the file is a ray.
bool is_image_file(const std::filesystem::path& file);
/// Number of scans per LiDAR from which units and beams are estimated.
inline constexpr std::size_t kSampleScans = 6;
/// Returns at most `most` of the indices 0 to n - 1, evenly spread, so that samples of a
/// log show different scenery.
inline std::vector<std::size_t> spread_indices(std::size_t n, std::size_t most) {
    std::vector<std::size_t> indices(std::min(most, n));
    for (std::size_t k = 0; k < indices.size(); ++k) indices[k] = k * n / indices.size();
    return indices;
}
/// Calls read(i) for some of n indices, evenly spread. Ignores errors, because they are
/// reported when the scans are read.
template <class Read>
void read_samples(std::size_t n, const Read& read, std::size_t most = kSampleScans) {
    for (const std::size_t i : spread_indices(n, most)) {
        try {
            read(i);
        } catch (const DataError&) {
            continue;
        }
    }
}

/// Returns true if the .npz files of a log contain points, and false if they contain
/// rays.
/// @throws DataError if the first .npz file contains neither
bool has_npz_points(const std::vector<std::filesystem::path>& scan_files);
/// Reads the points of a file. The extension of the file defines its format.
/// @param column_names  names of the columns in .bin and .npy files; empty: x y z
/// intensity
PointTable read_point_file(const std::filesystem::path& file, const std::vector<std::string>& column_names);

/// Reads a LAS file that contains a single scan.
/// @throws DataError if no points are near the origin, where the sensor is
PointTable parse_las(const SharedBytes& file, const std::string& where);
/// Reads a PCD file, whose header describes the fields. The points are text, binary point
/// by point, or compressed field by field.
PointTable parse_pcd(const SharedBytes& file, const std::string& where);
/// Reads a PLY file, whose header describes the fields.
PointTable parse_ply(const SharedBytes& file, const std::string& where);

/// Reads lines of numbers that are separated by blanks, commas or semicolons.
/// @param column_names  names of the fields if the file has no header. If empty, the
/// fields are x y z, or x y z intensity.
PointTable parse_text(const SharedBytes& file, const std::vector<std::string>& column_names,
                      const std::string& where);

/// Returns the points of a .npy file whose elements have named fields.
/// @param header  header of the file
PointTable parse_npy_fields(const SharedBytes& file, const codecs::NpyHeader& header,
                            const std::string& where);

}  // namespace relidar::read
