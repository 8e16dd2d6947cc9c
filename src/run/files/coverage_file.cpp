// SPDX-License-Identifier: Apache-2.0
#include "run/files/coverage_file.hpp"

#include <cstring>

#include "run/files/file_format.hpp"

namespace relidar::files {
namespace {

constexpr const char* kCoverageFormat = "relidar coverage";
constexpr const char* kCoverageVersion = "1";
constexpr const char* kClassesFormat = "relidar classes";
constexpr const char* kClassesVersion = "1";
constexpr const char* kCellSizeKey = "cell_m";

ArrayFile read_cell_file(const std::filesystem::path& path, const char* format, const char* version,
                         double cell_size_m) {
    ArrayFile file(path, format, version);
    if (const std::string expected = fmt::format("{}", cell_size_m); file.metadata[kCellSizeKey] != expected)
        fail("{}: {}: found {}, expected {}", file.path, kCellSizeKey, file.metadata[kCellSizeKey], expected);
    return file;
}

}  // namespace

void save_coverage(const std::filesystem::path& path, const ObservedVoxelSet& coverage) {
    if (coverage.empty()) return void(std::filesystem::remove(path));
    std::vector<std::int32_t> block_coordinates;
    std::vector<std::uint16_t> cells;
    for (const ObservedVoxelSet::VoxelBlock& block : coverage.list_blocks()) {
        for (int axis = 0; axis < 3; ++axis) block_coordinates.push_back(block.grid_index[axis]);
        cells.insert(cells.end(), block.cells.begin(), block.cells.end());
    }
    const std::size_t n = block_coordinates.size() / 3;
    write_array_file(path,
                     {make_array("place", {n, 3}, block_coordinates.data(), block_coordinates.size()),
                      make_array("cells", {n, ObservedVoxelSet::kBlockWords}, cells.data(), cells.size())},
                     kCoverageFormat, kCoverageVersion,
                     {{kCellSizeKey, fmt::format("{}", ObservedVoxelSet::kCell_m)}});
}

ObservedVoxelSet load_coverage(const std::filesystem::path& path) {
    const ArrayFile file = read_cell_file(path, kCoverageFormat, kCoverageVersion, ObservedVoxelSet::kCell_m);
    const NamedArray& block_coordinates = file.find("place", "i4", {kAnyLength, 3});
    const std::size_t n = block_coordinates.shape[0];
    const NamedArray& cells = file.find("cells", "u2", {n, ObservedVoxelSet::kBlockWords});
    ObservedVoxelSet coverage;
    for (std::size_t i = 0; i < n; ++i) {
        ObservedVoxelSet::VoxelBlock block;
        std::memcpy(&block.grid_index.x, block_coordinates.bytes.data() + i * 3 * sizeof(std::int32_t),
                    3 * sizeof(std::int32_t));
        std::memcpy(block.cells.data(), cells.bytes.data() + i * sizeof(ObservedVoxelSet::VoxelBits),
                    sizeof(ObservedVoxelSet::VoxelBits));
        coverage.add_block(block);
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
    write_array_file(
        path,
        {make_array("place", {class_map.size(), 3}, cell_coordinates.data(), cell_coordinates.size()),
         make_array("class", {class_map.size(), 1}, classes.data(), classes.size())},
        kClassesFormat, kClassesVersion, {{kCellSizeKey, fmt::format("{}", kClassCell_m)}});
}

SurfaceClassMap load_class_map(const std::filesystem::path& path) {
    const ArrayFile file = read_cell_file(path, kClassesFormat, kClassesVersion, kClassCell_m);
    const NamedArray& cell_coordinates = file.find("place", "i4", {kAnyLength, 3});
    SurfaceClassMap map(cell_coordinates.shape[0]);
    const NamedArray& classes = file.find("class", "u2", {map.size(), 1});
    for (std::size_t i = 0; i < map.size(); ++i) {
        std::memcpy(&map[i].grid_index.x, cell_coordinates.bytes.data() + i * 3 * sizeof(std::int32_t),
                    3 * sizeof(std::int32_t));
        std::uint16_t number;
        std::memcpy(&number, classes.bytes.data() + i * sizeof number, sizeof number);
        if (number >= kSurfaceClasses)
            fail("{}: cell {} of the class map has the class {}, expected a number from 0 to {}", file.path,
                 i, number, kSurfaceClasses - 1);
        map[i].surface = SurfaceClass(number);
    }
    return map;
}

}  // namespace relidar::files
