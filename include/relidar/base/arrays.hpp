// SPDX-License-Identifier: Apache-2.0
// Reads and writes named arrays as npz, npy and safetensors files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Number of elements along each axis.
using ArrayShape = std::vector<std::size_t>;

/// N-dimensional array of an npz or safetensors file. The values are stored row by row,
/// in little-endian byte order.
struct NamedArray {
    std::string name;
    /// Element type, named as in numpy without the byte order: f4 f8 f2, i1 i2 i4 i8, u1
    /// u2 u4 u8 or b1. Arrays of npz files may also hold text, with the types S<bytes>
    /// and U<letters>.
    std::string dtype;
    ArrayShape shape;
    std::vector<std::byte> bytes;

    std::size_t element_count() const;
    /// Returns the values converted to float. Booleans (b1) become 0 or 1.
    /// @throws DataError if the array holds text, or if the number of bytes does not
    /// match the shape
    std::vector<float> to_floats() const;
    /// Returns the values converted to double. Use this function for times and large
    /// coordinates, because single precision (float) is too coarse for them.
    std::vector<double> to_doubles() const;
};

/// Returns a pointer to the array with this name, or nullptr if the name does not exist.
const NamedArray* find_array(const std::vector<NamedArray>& arrays, std::string_view name);

/// Creates a named array from float, double, int32 or uint16 values.
/// @throws DataError if `count` is not the product of the shape
template <class T>
NamedArray make_array(std::string name, ArrayShape shape, const T* values, std::size_t count);
/// Creates an array of fixed-length strings in numpy's format (UTF-32, padded with
/// zeros).
/// @param texts UTF-8
/// @return array of shape [texts]
NamedArray make_text_array(std::string name, const std::vector<std::string>& texts);
/// Creates a zero-dimensional array (shape []) that holds one text.
NamedArray single_text(std::string name, const std::string& text);

/// Writes an npz file in the format of numpy.savez_compressed. Writing equal arrays twice
/// gives identical files.
/// @throws DataError if `arrays` is empty or the file cannot be written
void write_npz(const std::filesystem::path& path, const std::vector<NamedArray>& arrays);
/// Reads all arrays of an npz file. The arrays may be uncompressed or compressed with
/// deflate. They must be row-major and little-endian.
/// @throws DataError if the file is damaged or has another layout
std::vector<NamedArray> read_npz(const std::filesystem::path& path);
/// Reads the array of a .npy file. The file name becomes the name of the array.
/// @throws DataError if the file is damaged or has another layout
NamedArray read_npy(const std::filesystem::path& path);
/// Writes a safetensors file. The arrays keep their order.
/// @throws DataError if two arrays have the same name, a name is not UTF-8, or the file
/// cannot be written
void write_safetensors(const std::filesystem::path& path, const std::vector<NamedArray>& arrays,
                       const std::map<std::string, std::string>& metadata);
/// Reads a safetensors file. Returns the arrays in the order of their data in the file.
/// Does not check that values are finite.
/// @throws DataError if the file is damaged
std::vector<NamedArray> read_safetensors(const std::filesystem::path& path,
                                         std::map<std::string, std::string>* metadata = nullptr);

}  // namespace relidar
