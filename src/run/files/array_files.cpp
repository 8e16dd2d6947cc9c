// SPDX-License-Identifier: Apache-2.0
// Reads and writes the files of a run folder that have arrays and no surfels.
#include "run/files/run_files.hpp"

#include <cmath>
#include <cstring>

#include "base/number_text.hpp"
#include "run/files/file_format.hpp"

namespace relidar::files {
namespace {

namespace fs = std::filesystem;

constexpr const char *kCoverageFormat = "relidar coverage", *kClassesFormat = "relidar classes",
                     *kSweepsFormat = "relidar sweeps", *kScatterFormat = "relidar intensity scatter",
                     *kBodiesFormat = "relidar own bodies";
constexpr const char* kCellSizeKey = "cell_m";

/// Writes arrays to a file, or removes the file of an earlier save if all are empty.
void write_unless_empty(const fs::path& path, const std::vector<NamedArray>& arrays, const char* format,
                        const std::map<std::string, std::string>& metadata = {}) {
    const bool is_empty = std::ranges::all_of(arrays, [](const NamedArray& a) { return a.bytes.empty(); });
    if (is_empty) fs::remove(path);
    else write_array_file(path, arrays, format, metadata);
}

NamedArray make_place_array(const std::vector<glm::ivec3>& places) {
    return make_array("place", {places.size(), 3}, reinterpret_cast<const std::int32_t*>(places.data()),
                      3 * places.size());
}

/// Returns entry `index` of an array whose bytes are values of type T.
template <class T>
T read_entry(const NamedArray& array, std::size_t index) {
    T value;
    std::memcpy(&value, array.bytes.data() + index * sizeof(T), sizeof(T));
    return value;
}

/// Reads a file with values for cells of a grid. Throws if the cells have another size.
ArrayFile read_cell_file(const fs::path& path, const char* format, double cell_size_m) {
    ArrayFile file(path, format);
    if (const std::string expected = fmt::format("{}", cell_size_m); file.metadata[kCellSizeKey] != expected)
        fail("{}: {}: found {}, expected {}", file.path, kCellSizeKey, file.metadata[kCellSizeKey], expected);
    return file;
}

/// Returns the frame whose index in the log is the name of an array.
Frame& find_frame(const std::string& array_name, Log& log, const std::string& file_name) {
    const auto index = parse_integer<std::size_t>(array_name);
    if (!index || *index >= log.frames.size())
        fail("{}: the array name \"{}\" is not the index of a frame, expected a number below {}", file_name,
             array_name, log.frames.size());
    return log.frames[*index];
}

using TreeNode = IntensityScatterModel::DecisionTreeNode;

/// Returns one member of all nodes, in the type in which the file stores it.
template <class Stored, class Member>
std::vector<Stored> list_members(const std::vector<TreeNode>& nodes, Member TreeNode::*member) {
    std::vector<Stored> values;
    for (const TreeNode& node : nodes) values.push_back(Stored(node.*member));
    return values;
}

/// Stores the noise of a LiDAR's intensities: a decision tree, as one array per member of
/// a node, and the values of its leaves. An array has the name LIDAR.MEMBER.
void append_scatter(std::vector<NamedArray>& arrays, std::size_t lidar, const IntensityScatterModel& model) {
    const auto add = [&](const char* member, const auto& values) {
        arrays.push_back(make_vector_array(fmt::format("{}.{}", lidar, member), values));
    };
    add("feature", list_members<std::int32_t>(model.nodes, &TreeNode::feature));
    add("child", list_members<std::int32_t>(model.nodes, &TreeNode::child));
    add("first", list_members<std::int32_t>(model.nodes, &TreeNode::first));
    add("count", list_members<std::int32_t>(model.nodes, &TreeNode::count));
    add("at", list_members<float>(model.nodes, &TreeNode::at));
    add("values", model.values);
    add("step", std::vector{model.step});
}

/// Reads the noise of a LiDAR's intensities, as append_scatter() stores it: a decision
/// tree, with an array per member of a node. A branch compares the input `feature` with
/// `at` and continues with node `child` or the next node. A leaf (`feature` -1) has
/// `count` values from `first` on. Checks every node, so that each search in the tree
/// ends and reads existing values.
IntensityScatterModel read_scatter(const ArrayFile& file, std::size_t lidar) {
    const auto read = [&](const char* member, const char* dtype, std::size_t n_numbers = kAnyLength) {
        return file.find_numbers(fmt::format("{}.{}", lidar, member), dtype, n_numbers);
    };
    const std::vector<double> feature = read("feature", "i4"), values = read("values", "f4");
    const std::size_t n_nodes = feature.size();
    const std::vector<double> child = read("child", "i4", n_nodes), first = read("first", "i4", n_nodes),
                              count = read("count", "i4", n_nodes), at = read("at", "f4", n_nodes);
    IntensityScatterModel result;
    result.values.assign(values.begin(), values.end());
    for (std::size_t node = 0; node < n_nodes; ++node) {
        const bool is_leaf = feature[node] == -1.0;
        const bool has_feature = feature[node] >= 0.0 && feature[node] < double(count_features());
        // Children (child, child + 1) follow their parent, so there are no cycles.
        const bool has_children = child[node] > double(node) && child[node] + 1.0 < double(n_nodes);
        const bool has_values =
            first[node] >= 0.0 && count[node] > 0.0 && first[node] + count[node] <= double(values.size());
        const bool is_valid_branch = has_feature && has_children;
        if (!has_values || (!is_leaf && !is_valid_branch))
            fail(
                "{0}: node {2} of the decision tree for the intensities of LiDAR {1} is invalid (feature "
                "{3}, first child {4}, first value {5}, {6} values); expected a file that relidar has "
                "written",
                file.path, lidar, node, feature[node], child[node], first[node], count[node]);
        result.nodes.push_back({.feature = std::int32_t(feature[node]),
                                .at = float(at[node]),
                                .child = std::int32_t(child[node]),
                                .first = std::uint32_t(first[node]),
                                .count = std::uint32_t(count[node])});
    }
    result.step = read("step", "f8", 1)[0];  // quantisation of intensities; 0: none
    if (result.step < 0.0)
        fail("{}: the array {}.step contains {}, expected 0 or a positive number", file.path, lidar,
             result.step);
    return result;
}

}  // namespace

void save_azimuths(const fs::path& path, const Log& log) {
    std::vector<NamedArray> arrays;
    for (std::size_t i = 0; i < log.frames.size(); ++i)
        if (const std::vector<float>& shift_rad = log.frames[i].azimuth_shift_rad; !shift_rad.empty())
            arrays.push_back(make_vector_array(fmt::format("{:06}", i), shift_rad));
    write_unless_empty(path, arrays, kSweepsFormat);
}

/// Reads Frame::azimuth_shift_rad: how far each column of a sweep is from its nominal
/// azimuth. The name of an array is the index of its frame.
void load_azimuths(const fs::path& path, Log& log) {
    const ArrayFile file(path, kSweepsFormat);
    for (const NamedArray& array : file.arrays) {
        Frame& frame = find_frame(array.name, log, file.path);
        const auto columns = std::size_t(log.lidar_of(frame).sensor.columns);
        frame.azimuth_shift_rad = file.find(array.name, "f4", {columns}).to_floats();
        for (const float shift : frame.azimuth_shift_rad)
            if (!(std::abs(shift) <= float(kPi)))
                fail("{}: array {}: found {}, expected radians from -pi to pi", file.path, array.name, shift);
    }
}

void save_bodies(const fs::path& path, const std::vector<Lidar>& lidars) {
    std::vector<NamedArray> arrays;
    for (std::size_t i = 0; i < lidars.size(); ++i) {
        arrays.push_back(make_vector_array(fmt::format("{}.range_m", i), lidars[i].own_body.range_m));
        arrays.push_back(make_vector_array(fmt::format("{}.intensity", i), lidars[i].own_body.intensity));
    }
    write_unless_empty(path, arrays, kBodiesFormat);
}

void load_bodies(const fs::path& path, std::vector<Lidar>& lidars) {
    const ArrayFile file(path, kBodiesFormat);
    for (std::size_t i = 0; i < lidars.size(); ++i) {
        const auto read = [&](const char* member, double min, double max) {
            const std::string name = fmt::format("{}.{}", i, member);
            const std::vector<double> values = file.find_numbers(name, "f4");
            const bool is_table = values.empty() || values.size() == BodyTable::kCells;
            const auto is_valid = [&](double value) { return value >= min && value <= max; };
            if (!is_table || !std::ranges::all_of(values, is_valid))
                fail("{}: array {}: expected {} numbers from {} to {}", file.path, name, BodyTable::kCells,
                     min, max);
            return std::vector<float>(values.begin(), values.end());
        };
        BodyTable& body = lidars[i].own_body;
        body = {read("range_m", 0.0, 1e3), read("intensity", double(BodyTable::kNoReturn), 1.0)};
        if (body.range_m.size() != body.intensity.size())
            fail("{}: LiDAR {}: found {} ranges and {} intensities, expected equal numbers", file.path, i,
                 body.range_m.size(), body.intensity.size());
    }
}

void save_coverage(const fs::path& path, const ObservedVoxelSet& coverage) {
    std::vector<glm::ivec3> places;
    std::vector<std::uint16_t> cells;
    for (const ObservedVoxelSet::VoxelBlock& block : coverage.list_blocks()) {
        places.push_back(block.grid_index);
        cells.insert(cells.end(), block.cells.begin(), block.cells.end());
    }
    write_unless_empty(
        path,
        {make_place_array(places),
         make_array("cells", {places.size(), ObservedVoxelSet::kBlockWords}, cells.data(), cells.size())},
        kCoverageFormat, {{kCellSizeKey, fmt::format("{}", ObservedVoxelSet::kCell_m)}});
}

/// Reads the voxels that the log observed: blocks of voxels with one bit per voxel.
ObservedVoxelSet load_coverage(const fs::path& path) {
    const ArrayFile file = read_cell_file(path, kCoverageFormat, ObservedVoxelSet::kCell_m);
    const NamedArray& places = file.find("place", "i4", {kAnyLength, 3});
    const std::size_t n = places.shape[0];
    const NamedArray& cells = file.find("cells", "u2", {n, ObservedVoxelSet::kBlockWords});
    ObservedVoxelSet coverage;
    for (std::size_t i = 0; i < n; ++i)
        coverage.add_block(
            {read_entry<glm::ivec3>(places, i), read_entry<ObservedVoxelSet::VoxelBits>(cells, i)});
    return coverage;
}

void save_class_map(const fs::path& path, const SurfaceClassMap& class_map) {
    std::vector<glm::ivec3> places;
    std::vector<std::uint16_t> classes;
    for (const SurfaceClassCell& cell : class_map) {
        places.push_back(cell.grid_index);
        classes.push_back(std::uint16_t(cell.surface));
    }
    write_unless_empty(
        path,
        {make_place_array(places), make_array("class", {classes.size(), 1}, classes.data(), classes.size())},
        kClassesFormat, {{kCellSizeKey, fmt::format("{}", kClassCell_m)}});
}

/// Reads the class of the surface in each cell of a grid. `place` is the position of a
/// cell in units of cells.
SurfaceClassMap load_class_map(const fs::path& path) {
    const ArrayFile file = read_cell_file(path, kClassesFormat, kClassCell_m);
    const NamedArray& places = file.find("place", "i4", {kAnyLength, 3});
    SurfaceClassMap map(places.shape[0]);
    const NamedArray& classes = file.find("class", "u2", {map.size(), 1});
    for (std::size_t i = 0; i < map.size(); ++i) {
        const auto number = read_entry<std::uint16_t>(classes, i);
        if (number >= kSurfaceClasses)
            fail("{}: cell {} of the class map has the class {}, expected a number from 0 to {}", file.path,
                 i, number, kSurfaceClasses - 1);
        map[i] = {read_entry<glm::ivec3>(places, i), SurfaceClass(number)};
    }
    return map;
}

void save_scatter(const fs::path& path, const std::vector<IntensityScatterModel>& scatter) {
    std::vector<NamedArray> arrays;
    for (std::size_t lidar = 0; lidar < scatter.size(); ++lidar)
        if (!scatter[lidar].empty()) append_scatter(arrays, lidar, scatter[lidar]);
    write_unless_empty(path, arrays, kScatterFormat);
}

std::vector<IntensityScatterModel> load_scatter(const fs::path& path, std::size_t n_lidars) {
    const ArrayFile file(path, kScatterFormat);
    std::vector<IntensityScatterModel> result(n_lidars);
    for (std::size_t lidar = 0; lidar < n_lidars; ++lidar)
        if (find_array(file.arrays, fmt::format("{}.feature", lidar)))
            result[lidar] = read_scatter(file, lidar);
    return result;
}

}  // namespace relidar::files
