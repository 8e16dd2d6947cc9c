// SPDX-License-Identifier: Apache-2.0
// Reads and writes the coverage of a run as a safetensors file. The coverage is the space
// that the sensors of the log have observed.
#include "run/files/coverage_file.hpp"

#include <cstring>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "run/files/file_format.hpp"

namespace relidar::run_detail {
namespace {

constexpr const char* kCoverageFormat = "relidar coverage";
constexpr const char* kCoverageVersion = "1";
constexpr const char* kCell = "cell_m";

/// Returns the array of the file with this name.
/// @throws DataError if no array has this name, or if its type or number of columns is
/// wrong
const NamedArray& table(const std::vector<NamedArray>& arrays, const char* name, const char* dtype,
                        std::size_t width, const std::string& file) {
    const NamedArray* array = find_array(arrays, name);
    if (!array) throw DataError(fmt::format("{}: array {} is missing", file, name));
    if (array->dtype != dtype || array->shape.size() != 2 || array->shape[1] != width)
        throw DataError(fmt::format("{}: array {}: found {} [{}], expected {} [blocks, {}]", file, name,
                                    array->dtype, fmt::join(array->shape, ", "), dtype, width));
    return *array;
}

}  // namespace

void save_coverage(const std::filesystem::path& path, const Coverage& coverage) {
    if (coverage.empty()) return void(std::filesystem::remove(path));
    std::vector<std::int32_t> places;
    std::vector<std::uint16_t> cells;
    for (const Coverage::Block& block : coverage.blocks()) {
        for (int axis = 0; axis < 3; ++axis) places.push_back(block.place[axis]);
        cells.insert(cells.end(), block.cells.begin(), block.cells.end());
    }
    const std::size_t n = places.size() / 3;
    const std::string cell_m = fmt::format("{}", Coverage::kCell_m);
    write_safetensors(path,
                      {make_array("place", {n, 3}, places.data(), places.size()),
                       make_array("cells", {n, Coverage::kWords}, cells.data(), cells.size())},
                      {{"format", kCoverageFormat},
                       {"version", kCoverageVersion},
                       {"relidar", RELIDAR_VERSION},
                       {kCell, cell_m}});
}

Coverage load_coverage(const std::filesystem::path& path) {
    const std::string file = path.string();
    std::map<std::string, std::string> metadata;
    const std::vector<NamedArray> arrays = read_safetensors(path, &metadata);
    check_format(metadata, file, kCoverageFormat, kCoverageVersion);
    if (const std::string expected = fmt::format("{}", Coverage::kCell_m); metadata[kCell] != expected)
        throw DataError(fmt::format("{}: {}: found {}, expected {}", file, kCell, metadata[kCell], expected));
    const NamedArray &places = table(arrays, "place", "i4", 3, file),
                     &cells = table(arrays, "cells", "u2", Coverage::kWords, file);
    if (places.shape[0] != cells.shape[0])
        throw DataError(fmt::format(
            "{}: the array of places has {} rows and the array of cells has {}, expected the same "
            "number of rows",
            file, places.shape[0], cells.shape[0]));
    Coverage coverage;
    for (std::size_t i = 0; i < places.shape[0]; ++i) {
        Coverage::Block block;
        std::memcpy(&block.place.x, places.bytes.data() + i * 3 * sizeof(std::int32_t),
                    3 * sizeof(std::int32_t));
        std::memcpy(block.cells.data(), cells.bytes.data() + i * sizeof(Coverage::Cells),
                    sizeof(Coverage::Cells));
        coverage.add(block);
    }
    return coverage;
}

}  // namespace relidar::run_detail
