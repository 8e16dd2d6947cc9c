// SPDX-License-Identifier: Apache-2.0
// Writes Feather V2 files with the metadata from the flatbuffers builder.
#pragma once

#include <string>
#include <vector>

namespace relidar::test {

struct FeatherColumn {
    enum class Kind { integer, floating, text } kind = Kind::integer;
    std::string name;
    int bits = 0;
    bool is_signed = false;
    std::string values;              ///< bytes of numbers
    std::vector<std::string> texts;  ///< values of a text column
    bool by_dictionary = false;

    std::size_t rows() const {
        return kind == Kind::text ? texts.size() : values.size() / std::size_t(bits / 8);
    }
};

template <class T>
FeatherColumn make_numbers(const std::string& name, const std::vector<T>& values) {
    FeatherColumn column{
        std::is_floating_point_v<T> ? FeatherColumn::Kind::floating : FeatherColumn::Kind::integer,
        name,
        int(8 * sizeof(T)),
        std::is_signed_v<T>,
        {},
        {},
        false};
    column.values.assign(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
    return column;
}
FeatherColumn make_halves(const std::string& name, const std::vector<float>& values);
FeatherColumn make_texts(const std::string& name, const std::vector<std::string>& texts,
                         bool by_dictionary = false);

enum class FeatherCodec { none, lz4, zstd };

/// @param rows_a_batch rows per record batch; 0: a single record batch
std::string make_feather_bytes(const std::vector<FeatherColumn>& columns,
                               FeatherCodec codec = FeatherCodec::none, std::size_t rows_a_batch = 0);

}  // namespace relidar::test
