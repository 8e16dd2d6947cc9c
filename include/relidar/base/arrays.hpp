// SPDX-License-Identifier: Apache-2.0
// Named arrays, and the files that hold them: npz, npy and safetensors.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// An n-dimensional array of an npz or safetensors file, row-major, little-endian.
struct NamedArray {
    std::string name;
    /// numpy's names without byte order: f4 f8 f2, i1 i2 i4 i8, u1 u2 u4 u8, b1; npz
    /// alone: S<bytes>, U<letters>
    std::string dtype;
    std::vector<std::size_t> shape;
    std::vector<std::byte> bytes;

    std::size_t count() const;
    /// Values converted to float (b1 as 0 or 1). @throws DataError for text, or where
    /// bytes do not fill the shape
    std::vector<float> as_float() const;
    std::vector<double> as_double() const;  ///< the same, for times and large coordinates
};

/// The array of a name; nothing where there is none.
const NamedArray* find_array(const std::vector<NamedArray>& arrays, std::string_view name);

/// Array of float, double, int32 or uint16 values. @throws DataError where n is not the
/// product of shape
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const float* values, std::size_t n);
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const double* values, std::size_t n);
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const std::int32_t* values,
                      std::size_t n);
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const std::uint16_t* values,
                      std::size_t n);
/// Texts as numpy's fixed-length strings (UTF-32 padded with zeros). @param texts  UTF-8
/// @return [texts]
NamedArray make_text_array(std::string name, const std::vector<std::string>& texts);
/// One text, of shape [].
NamedArray make_text(std::string name, const std::string& text);

/// npz as numpy.savez_compressed writes it; equal arrays make equal files. @throws
/// DataError beyond 4 GiB, as for write_atomically
void write_npz(const std::filesystem::path& path, const std::vector<NamedArray>& arrays);
/// Arrays of an npz file, stored or deflated, row-major and little-endian. @throws
/// DataError for anything else, or damage
std::vector<NamedArray> read_npz(const std::filesystem::path& path);
/// The array of a .npy file, named after it. @throws DataError as read_npz
NamedArray read_npy(const std::filesystem::path& path);
/// safetensors, arrays in the given order. @throws DataError for names used twice or not
/// UTF-8, as for write_atomically
void write_safetensors(const std::filesystem::path& path, const std::vector<NamedArray>& arrays,
                       const std::map<std::string, std::string>& metadata);
/// Arrays in the order of their data. Whether values are finite is not checked. @throws
/// DataError for a file that is damaged
std::vector<NamedArray> read_safetensors(const std::filesystem::path& path,
                                         std::map<std::string, std::string>* metadata = nullptr);

}  // namespace relidar
