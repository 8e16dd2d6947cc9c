// SPDX-License-Identifier: Apache-2.0
#include "run/files/coverage_file.hpp"

#include <cstring>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "run/files/file_format.hpp"

namespace relidar::run_detail {
namespace {

constexpr const char* kCoverageFormat = "relidar coverage";
constexpr const char* kCoverageVersion = "1";
constexpr const char* kClassesFormat = "relidar classes";
constexpr const char* kClassesVersion = "1";
constexpr const char* kCell = "cell_m";

/// Checks format, version and voxel size.
std::vector<NamedArray> read_cell_arrays(const std::filesystem::path& path, const char* expected_format,
                                         const char* expected_version, double expected_cell_size_m) {
    std::map<std::string, std::string> metadata;
    std::vector<NamedArray> arrays = read_safetensors(path, &metadata);
    require_format_and_version(metadata, path.string(), expected_format, expected_version);
    if (const std::string expected = fmt::format("{}", expected_cell_size_m); metadata[kCell] != expected)
        fail("{}: {}: found {}, expected {}", path.string(), kCell, metadata[kCell], expected);
    return arrays;
}

void write_cell_arrays(const std::filesystem::path& path, const std::vector<NamedArray>& arrays,
                       const char* format, const char* version, double cell_size_m) {
    write_safetensors(path, arrays,
                      {{"format", format},
                       {"version", version},
                       {"relidar", RELIDAR_VERSION},
                       {kCell, fmt::format("{}", cell_size_m)}});
}

/// @throws DataError if the file has no such array of this type and width
const NamedArray& require_array_with_columns(const std::vector<NamedArray>& arrays, const char* name,
                                             const char* dtype, std::size_t n_columns,
                                             const std::string& file_name, const char* row_unit = "blocks") {
    const NamedArray* array = find_array(arrays, name);
    if (!array) fail("{}: array {} is missing", file_name, name);
    if (array->dtype != dtype || array->shape.size() != 2 || array->shape[1] != n_columns)
        fail(
            "{}: the array {} has the type {} and the shape [{}], expected the type {} and the shape [n, "
            "{}], where n is the number of {}",
            file_name, name, array->dtype, fmt::join(array->shape, ", "), dtype, n_columns, row_unit);
    return *array;
}

void require_equal_row_counts(const NamedArray& positions, const NamedArray& values,
                              const std::string& file_name) {
    if (positions.shape[0] != values.shape[0])
        fail(
            "{}: the array of positions has {} rows and the array of {} has {} rows, expected the same "
            "number",
            file_name, positions.shape[0], values.name, values.shape[0]);
}

}  // namespace

void save_coverage(const std::filesystem::path& path, const ObservedVoxelSet& coverage) {
    if (coverage.empty()) return void(std::filesystem::remove(path));
    std::vector<std::int32_t> block_coordinates;
    std::vector<std::uint16_t> cells;
    for (const ObservedVoxelSet::VoxelBlock& block : coverage.list_voxel_blocks()) {
        for (int axis = 0; axis < 3; ++axis) block_coordinates.push_back(block.grid_index[axis]);
        cells.insert(cells.end(), block.cells.begin(), block.cells.end());
    }
    const std::size_t n = block_coordinates.size() / 3;
    write_cell_arrays(path,
                      {make_array("place", {n, 3}, block_coordinates.data(), block_coordinates.size()),
                       make_array("cells", {n, ObservedVoxelSet::kWords}, cells.data(), cells.size())},
                      kCoverageFormat, kCoverageVersion, ObservedVoxelSet::kCell_m);
}

ObservedVoxelSet load_coverage(const std::filesystem::path& path) {
    const std::string file = path.string();
    const std::vector<NamedArray> arrays =
        read_cell_arrays(path, kCoverageFormat, kCoverageVersion, ObservedVoxelSet::kCell_m);
    const NamedArray &block_coordinates = require_array_with_columns(arrays, "place", "i4", 3, file),
                     &cells =
                         require_array_with_columns(arrays, "cells", "u2", ObservedVoxelSet::kWords, file);
    require_equal_row_counts(block_coordinates, cells, file);
    ObservedVoxelSet coverage;
    for (std::size_t i = 0; i < block_coordinates.shape[0]; ++i) {
        ObservedVoxelSet::VoxelBlock block;
        std::memcpy(&block.grid_index.x, block_coordinates.bytes.data() + i * 3 * sizeof(std::int32_t),
                    3 * sizeof(std::int32_t));
        std::memcpy(block.cells.data(), cells.bytes.data() + i * sizeof(ObservedVoxelSet::VoxelBits),
                    sizeof(ObservedVoxelSet::VoxelBits));
        coverage.add_voxels_of_block(block);
    }
    return coverage;
}

void save_class_map(const std::filesystem::path& path, const SurfaceClassMap& class_map) {
    if (class_map.empty()) return void(std::filesystem::remove(path));
    std::vector<std::int32_t> cell_coordinates;
    std::vector<std::uint16_t> classes;
    for (const SurfaceClassCell& cell : class_map) {
        for (int axis = 0; axis < 3; ++axis) cell_coordinates.push_back(cell.grid_index[axis]);
        classes.push_back(std::uint16_t(cell.surface));
    }
    write_cell_arrays(
        path,
        {make_array("place", {class_map.size(), 3}, cell_coordinates.data(), cell_coordinates.size()),
         make_array("class", {class_map.size(), 1}, classes.data(), classes.size())},
        kClassesFormat, kClassesVersion, kClassCell_m);
}

SurfaceClassMap load_class_map(const std::filesystem::path& path) {
    const std::string file = path.string();
    const std::vector<NamedArray> arrays =
        read_cell_arrays(path, kClassesFormat, kClassesVersion, kClassCell_m);
    const NamedArray &cell_coordinates = require_array_with_columns(arrays, "place", "i4", 3, file, "cells"),
                     &classes = require_array_with_columns(arrays, "class", "u2", 1, file, "cells");
    require_equal_row_counts(cell_coordinates, classes, file);
    SurfaceClassMap map(cell_coordinates.shape[0]);
    for (std::size_t i = 0; i < map.size(); ++i) {
        std::memcpy(&map[i].grid_index.x, cell_coordinates.bytes.data() + i * 3 * sizeof(std::int32_t),
                    3 * sizeof(std::int32_t));
        std::uint16_t number;
        std::memcpy(&number, classes.bytes.data() + i * sizeof number, sizeof number);
        if (number >= kSurfaceClasses)
            fail("{}: cell {} of the class map has the class {}, expected a number from 0 to {}", file, i,
                 number, kSurfaceClasses - 1);
        map[i].surface = SurfaceClass(number);
    }
    return map;
}

}  // namespace relidar::run_detail
