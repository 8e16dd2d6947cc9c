// SPDX-License-Identifier: Apache-2.0
#include "run/files/scatter_file.hpp"

#include <cstdint>

#include "run/files/file_format.hpp"

namespace relidar::files {
namespace {

constexpr const char* kScatterFormat = "relidar intensity scatter";
constexpr const char* kScatterVersion = "1";

using Node = IntensityScatterModel::DecisionTreeNode;

/// Stores a decision tree as one array per member of a node, named INDEX.MEMBER.
void append_scatter(std::vector<NamedArray>& arrays, std::size_t index, const IntensityScatterModel& model) {
    std::vector<std::int32_t> feature, child, first, count;
    std::vector<float> at;
    for (const Node& node : model.nodes) {
        feature.push_back(node.feature);
        child.push_back(node.child);
        first.push_back(std::int32_t(node.first));
        count.push_back(std::int32_t(node.count));
        at.push_back(node.at);
    }
    const auto name = [&](const char* text) { return fmt::format("{}.{}", index, text); };
    arrays.push_back(make_vector_array(name("feature"), feature));
    arrays.push_back(make_vector_array(name("child"), child));
    arrays.push_back(make_vector_array(name("first"), first));
    arrays.push_back(make_vector_array(name("count"), count));
    arrays.push_back(make_vector_array(name("at"), at));
    arrays.push_back(make_vector_array(name("values"), model.values));
    arrays.push_back(make_vector_array(name("step"), std::vector{model.step}));
}

IntensityScatterModel read_scatter(const ArrayFile& file, std::size_t lidar) {
    const auto read = [&](const char* suffix, const char* dtype, std::size_t count = kAnyLength) {
        return file.find_numbers(fmt::format("{}.{}", lidar, suffix), dtype, count);
    };
    const std::vector<double> feature = read("feature", "i4"), values = read("values", "f4");
    const std::size_t n = feature.size();
    const std::vector<double> child = read("child", "i4", n), first = read("first", "i4", n),
                              count = read("count", "i4", n), at = read("at", "f4", n);
    IntensityScatterModel result;
    result.values.assign(values.begin(), values.end());
    const double n_features = double(count_features());
    for (std::size_t i = 0; i < n; ++i) {
        const bool is_leaf = feature[i] == -1.0;
        const bool has_feature = feature[i] >= 0.0 && feature[i] < n_features;
        // Both children are stored one after the other, behind their parent. This makes
        // cycles impossible.
        const bool has_children = child[i] > double(i) && child[i] + 1.0 < double(n);
        const bool has_values =
            first[i] >= 0.0 && count[i] > 0.0 && first[i] + count[i] <= double(values.size());
        if (!has_values || !(is_leaf || (has_feature && has_children)))
            fail(
                "{0}: node {2} of the decision tree for the intensities of LiDAR {1} is invalid (feature "
                "{3}, first child {4}, first value {5}, {6} values); expected a file that relidar has "
                "written",
                file.path, lidar, i, feature[i], child[i], first[i], count[i]);
        result.nodes.push_back({std::int32_t(feature[i]), float(at[i]), std::int32_t(child[i]),
                                std::uint32_t(first[i]), std::uint32_t(count[i])});
    }
    result.step = read("step", "f8", 1)[0];
    if (result.step < 0.0)
        fail(
            "{0}: the array {1}.step (step between two intensities of LiDAR {1}) contains {2}, expected 0 or "
            "a positive number",
            file.path, lidar, result.step);
    return result;
}

}  // namespace

void save_scatter(const std::filesystem::path& path, const std::vector<IntensityScatterModel>& scatter) {
    std::vector<NamedArray> arrays;
    for (std::size_t lidar = 0; lidar < scatter.size(); ++lidar)
        if (!scatter[lidar].empty()) append_scatter(arrays, lidar, scatter[lidar]);
    if (arrays.empty()) return void(std::filesystem::remove(path));
    write_array_file(path, arrays, kScatterFormat, kScatterVersion);
}

std::vector<IntensityScatterModel> load_scatter(const std::filesystem::path& path, std::size_t n_lidars) {
    const ArrayFile file(path, kScatterFormat, kScatterVersion);
    std::vector<IntensityScatterModel> result(n_lidars);
    for (std::size_t lidar = 0; lidar < n_lidars; ++lidar)
        if (find_array(file.arrays, fmt::format("{}.feature", lidar)))
            result[lidar] = read_scatter(file, lidar);
    return result;
}

}  // namespace relidar::files
