// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <fmt/ranges.h>

#include <relidar/base/arrays.hpp>

#include "base/fail.hpp"

namespace relidar::files {

inline constexpr auto kAnyLength = static_cast<std::size_t>(-1);
inline constexpr const char* kFileVersion = "1";

struct ArrayFile {
    std::string path;
    std::map<std::string, std::string> metadata;
    std::vector<NamedArray> arrays;

    /// Reads a safetensors file. Throws if its metadata name another format or version.
    ArrayFile(const std::filesystem::path& file, const std::string& format)
        : path(file.string()), arrays(read_safetensors(file, &metadata)) {
        if (metadata["format"] != format)
            fail("{}: metadata \"format\": found \"{}\", expected \"{}\"", path, metadata["format"], format);
        if (metadata["version"] != kFileVersion)
            fail(
                "{}: metadata version: found \"{}\", but relidar {} reads only version {}; train the run "
                "again",
                path, metadata["version"], RELIDAR_VERSION, kFileVersion);
    }
    /// @param shape  kAnyLength for a dimension of any length
    /// @throws DataError if the array is missing or has another type or shape
    const NamedArray& find(const std::string& name, const char* dtype,
                           const std::vector<std::size_t>& shape) const {
        const NamedArray* array = find_array(arrays, name);
        if (!array) fail("{}: the array {} is missing", path, name);
        const auto is_length = [](std::size_t n, std::size_t expected) {
            return expected == kAnyLength || n == expected;
        };
        if (array->dtype == dtype && std::ranges::equal(array->shape, shape, is_length)) return *array;
        std::vector<std::string> lengths;
        for (const std::size_t n : shape) lengths.push_back(n == kAnyLength ? "n" : fmt::format("{}", n));
        fail("{}: the array {} has the type {} and the shape [{}], expected the type {} and the shape [{}]",
             path, name, array->dtype, fmt::join(array->shape, ", "), dtype, fmt::join(lengths, ", "));
    }
    std::vector<double> find_numbers(const std::string& name, const char* dtype,
                                     std::size_t count = kAnyLength) const {
        const std::vector<double> values = find(name, dtype, {count}).to_doubles();
        for (std::size_t i = 0; i < values.size(); ++i)
            if (!std::isfinite(values[i]))
                fail("{}: array {}: entry {} is {}, expected a finite number", path, name, i, values[i]);
        return values;
    }
};

inline void write_array_file(const std::filesystem::path& path, const std::vector<NamedArray>& arrays,
                             const std::string& format, std::map<std::string, std::string> metadata = {}) {
    metadata.insert({{"format", format}, {"version", kFileVersion}, {"relidar", RELIDAR_VERSION}});
    write_safetensors(path, arrays, metadata);
}

template <class Value>
NamedArray make_vector_array(const std::string& name, const std::vector<Value>& values) {
    return make_array(name, {values.size()}, values.data(), values.size());
}

}  // namespace relidar::files
