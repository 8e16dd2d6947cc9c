// SPDX-License-Identifier: Apache-2.0
// Points as people's files hold them: PCD, PLY, .bin, .npy. Each format says where its
// fields lie; the rest is the same for all. Numbers keep the type of the file, and are
// read where they lie.
#pragma once

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

#include "base/shared_bytes.hpp"

namespace relidar::folder {

/// A value of a point that relidar reads.
enum class PointValue { x, y, z, intensity, ring, time, return_number, return_type };

/// The value that a field of this name holds; nothing for fields that relidar does not
/// read, such as colours and normals. The only list of names.
std::optional<PointValue> value_of_field(std::string_view name);
inline bool is_point_field(std::string_view name) { return value_of_field(name).has_value(); }

enum class NumberType : std::uint8_t { f4, f8, i1, i2, i4, i8, u1, u2, u4, u8 };

/// The numbers of one field, in the type and at the place that the file gives them.
class FieldValues {
public:
    /// @param first  the number of point 0 @param step  bytes from one point to the next
    FieldValues(NumberType type, const char* first, std::size_t step)
        : first_(first), step_(step), type_(type) {}

    /// Calls use(value_at), where value_at(i) is the number of point i in its own type.
    template <class Use>
    void visit(const Use& use) const {
        switch (type_) {
            case NumberType::f4:
                return use(reader<float>());
            case NumberType::f8:
                return use(reader<double>());
            case NumberType::i1:
                return use(reader<std::int8_t>());
            case NumberType::i2:
                return use(reader<std::int16_t>());
            case NumberType::i4:
                return use(reader<std::int32_t>());
            case NumberType::i8:
                return use(reader<std::int64_t>());
            case NumberType::u1:
                return use(reader<std::uint8_t>());
            case NumberType::u2:
                return use(reader<std::uint16_t>());
            case NumberType::u4:
                return use(reader<std::uint32_t>());
            case NumberType::u8:
                return use(reader<std::uint64_t>());
        }
    }
    /// One number. For all numbers visit() is faster.
    double operator[](std::size_t i) const {
        double value = 0.0;
        visit([&](const auto& value_at) { value = double(value_at(i)); });
        return value;
    }

private:
    const char* first_;
    std::size_t step_;
    NumberType type_;

    template <class T>
    auto reader() const {
        return [first = first_, step = step_](std::size_t i) {
            T value;
            std::memcpy(&value, first + i * step, sizeof value);
            return value;
        };
    }
};

/// Fields of the points, those that relidar knows. Copies share the numbers.
class PointTable {
public:
    explicit PointTable(std::size_t n_points = 0) : n(n_points) {}

    std::size_t n;             ///< points
    bool is_deskewed = false;  ///< the file says that its points are deskewed or in the world

    /// The field of a value, or nullptr. If several names of the value are there, the one
    /// that the list of names has first.
    const FieldValues* find(PointValue value) const;
    /// @param where  file, for messages @throws DataError if there is a field of this name
    void add(const std::string& name, const FieldValues& values, const std::string& where);
    template <class T>
    void add(const std::string& name, NumberType type, std::vector<T> values, const std::string& where) {
        const auto memory = std::make_shared<const std::vector<T>>(std::move(values));
        keep(memory);
        add(name, {type, reinterpret_cast<const char*>(memory->data()), sizeof(T)}, where);
    }
    void remove(PointValue value);
    /// Keeps memory that fields look at.
    void keep(std::shared_ptr<const void> memory) { memory_.push_back(std::move(memory)); }

private:
    std::map<std::string, FieldValues> fields_;
    std::vector<std::shared_ptr<const void>> memory_;
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
PointTable read_packed(const SharedBytes& data, const std::vector<PointField>& fields, std::size_t n,
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
PointTable read_pcd(const SharedBytes& file, const std::string& where);
PointTable read_ply(const SharedBytes& file, const std::string& where);

}  // namespace relidar::folder
