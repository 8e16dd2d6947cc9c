// SPDX-License-Identifier: Apache-2.0
// Reads and writes the coverage and the class map of a run as safetensors files. The
// coverage is the space that the sensors of the log have observed. The class map has the
// classes of the background.
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
constexpr const char* kClassesFormat = "relidar classes";
constexpr const char* kClassesVersion = "1";
constexpr const char* kCell = "cell_m";

/// Reads the arrays of a file with cells. Checks the format of the file and the size of
/// its cells.
std::vector<NamedArray> read_cells(const std::filesystem::path& path, const char* format, const char* version,
                                   double cell_m) {
    std::map<std::string, std::string> metadata;
    std::vector<NamedArray> arrays = read_safetensors(path, &metadata);
    check_format(metadata, path.string(), format, version);
    if (const std::string expected = fmt::format("{}", cell_m); metadata[kCell] != expected)
        throw DataError(
            fmt::format("{}: {}: found {}, expected {}", path.string(), kCell, metadata[kCell], expected));
    return arrays;
}

/// Writes the arrays of a file with cells.
void write_cells(const std::filesystem::path& path, const std::vector<NamedArray>& arrays, const char* format,
                 const char* version, double cell_m) {
    write_safetensors(path, arrays,
                      {{"format", format},
                       {"version", version},
                       {"relidar", RELIDAR_VERSION},
                       {kCell, fmt::format("{}", cell_m)}});
}

/// Returns an array of the file by its name, and checks its type and its number of
/// columns.
/// @throws DataError if the file has no such array of this type and width
const NamedArray& find_coverage_array(const std::vector<NamedArray>& arrays, const char* name,
                                      const char* dtype, std::size_t width, const std::string& file,
                                      const char* rows = "blocks") {
    const NamedArray* array = find_array(arrays, name);
    if (!array) throw DataError(fmt::format("{}: array {} is missing", file, name));
    if (array->dtype != dtype || array->shape.size() != 2 || array->shape[1] != width)
        throw DataError(fmt::format("{}: array {}: found {} [{}], expected {} [{}, {}]", file, name,
                                    array->dtype, fmt::join(array->shape, ", "), dtype, rows, width));
    return *array;
}

/// @throws DataError if the two arrays have different numbers of rows
void check_rows(const NamedArray& places, const NamedArray& values, const std::string& file) {
    if (places.shape[0] != values.shape[0])
        throw DataError(
            fmt::format("{}: the array of places has {} rows and the array of {} has {}, expected the same "
                        "number of rows",
                        file, places.shape[0], values.name, values.shape[0]));
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
    write_cells(path,
                {make_array("place", {n, 3}, places.data(), places.size()),
                 make_array("cells", {n, Coverage::kWords}, cells.data(), cells.size())},
                kCoverageFormat, kCoverageVersion, Coverage::kCell_m);
}

Coverage load_coverage(const std::filesystem::path& path) {
    const std::string file = path.string();
    const std::vector<NamedArray> arrays =
        read_cells(path, kCoverageFormat, kCoverageVersion, Coverage::kCell_m);
    const NamedArray &places = find_coverage_array(arrays, "place", "i4", 3, file),
                     &cells = find_coverage_array(arrays, "cells", "u2", Coverage::kWords, file);
    check_rows(places, cells, file);
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

void save_classes(const std::filesystem::path& path, const ClassMap& map) {
    if (map.empty()) return void(std::filesystem::remove(path));
    std::vector<std::int32_t> places;
    std::vector<std::uint16_t> classes;
    for (const ClassCell& cell : map) {
        for (int axis = 0; axis < 3; ++axis) places.push_back(cell.place[axis]);
        classes.push_back(std::uint16_t(cell.surface));
    }
    write_cells(path,
                {make_array("place", {map.size(), 3}, places.data(), places.size()),
                 make_array("class", {map.size(), 1}, classes.data(), classes.size())},
                kClassesFormat, kClassesVersion, kClassCell_m);
}

ClassMap load_classes(const std::filesystem::path& path) {
    const std::string file = path.string();
    const std::vector<NamedArray> arrays = read_cells(path, kClassesFormat, kClassesVersion, kClassCell_m);
    const NamedArray &places = find_coverage_array(arrays, "place", "i4", 3, file, "cells"),
                     &classes = find_coverage_array(arrays, "class", "u2", 1, file, "cells");
    check_rows(places, classes, file);
    ClassMap map(places.shape[0]);
    for (std::size_t i = 0; i < map.size(); ++i) {
        std::memcpy(&map[i].place.x, places.bytes.data() + i * 3 * sizeof(std::int32_t),
                    3 * sizeof(std::int32_t));
        std::uint16_t number;
        std::memcpy(&number, classes.bytes.data() + i * sizeof number, sizeof number);
        if (number >= kSurfaceClasses)
            throw DataError(fmt::format("{}: class of cell {}: found {}, expected a number below {}", file, i,
                                        number, kSurfaceClasses));
        map[i].surface = SurfaceClass(number);
    }
    return map;
}

}  // namespace relidar::run_detail
