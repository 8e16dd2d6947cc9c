// SPDX-License-Identifier: Apache-2.0
// .npy data: magic bytes, a version, a header with type, order and shape, and the values.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <relidar/base/arrays.hpp>

namespace relidar::codecs {

/// A field of structured elements. Types are numpy's, for example "<f4".
struct NpyField {
    std::string name, type;
    ArrayShape shape = {};  ///< shape of the field in each element
};

struct NpyHeader {
    std::string type;              ///< type of plain elements; empty if the elements have fields
    std::vector<NpyField> fields;  ///< fields of structured elements
    bool fortran_order = false;
    ArrayShape shape;
    std::string_view values;  ///< bytes after the header
};

NpyHeader parse_npy_header(std::string_view bytes);
std::string make_npy_header(const NamedArray& array);
NamedArray parse_npy(const std::string& name, std::string_view bytes);

}  // namespace relidar::codecs
