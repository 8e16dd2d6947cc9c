// SPDX-License-Identifier: Apache-2.0
#include "run/files/scatter_file.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <string>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "run/files/file_format.hpp"

namespace relidar::run_detail {
namespace {

constexpr const char* kScatterFormat = "relidar intensity scatter";
constexpr const char* kScatterVersion = "1";

using Node = IntensityScatterModel::DecisionTreeNode;

template <class Value>
NamedArray make_one_dimensional_array(const std::string& name, const std::vector<Value>& values) {
    return make_array(name, {values.size()}, values.data(), values.size());
}

void append_scatter_arrays(std::vector<NamedArray>& arrays, std::size_t lidar_index,
                           const IntensityScatterModel& scatter) {
    std::vector<std::int32_t> feature, child, first, count;
    std::vector<float> at;
    for (const Node& node : scatter.nodes) {
        feature.push_back(node.feature);
        child.push_back(node.child);
        first.push_back(std::int32_t(node.first));
        count.push_back(std::int32_t(node.count));
        at.push_back(node.at);
    }
    const auto name = [&](const char* description) { return fmt::format("{}.{}", lidar_index, description); };
    arrays.push_back(make_one_dimensional_array(name("feature"), feature));
    arrays.push_back(make_one_dimensional_array(name("child"), child));
    arrays.push_back(make_one_dimensional_array(name("first"), first));
    arrays.push_back(make_one_dimensional_array(name("count"), count));
    arrays.push_back(make_one_dimensional_array(name("at"), at));
    arrays.push_back(make_one_dimensional_array(name("values"), scatter.values));
    arrays.push_back(make_one_dimensional_array(name("step"), std::vector{scatter.step}));
}

/// of one LiDAR
struct ScatterArrays {
    const std::vector<NamedArray>& arrays;
    const std::string& file;
    const std::size_t lidar;

    /// any length if `expected_count` is 0
    std::vector<double> read_finite_array(const char* array_suffix, const char* dtype,
                                          std::size_t expected_count = 0) const {
        const std::string name = fmt::format("{}.{}", lidar, array_suffix);
        const NamedArray* array = find_array(arrays, name);
        if (!array) fail("{}: array {} is missing", file, name);
        if (array->dtype != dtype || array->shape.size() != 1 || array->count_array_elements() == 0 ||
            (expected_count > 0 && array->count_array_elements() != expected_count))
            fail("{}: array {}: found type {} with {} numbers, expected {}{}", file, name, array->dtype,
                 array->count_array_elements(), dtype,
                 expected_count > 0 ? fmt::format(" with {} numbers", expected_count) : "");
        std::vector<double> values = array->convert_to_doubles();
        if (!std::ranges::all_of(values, [](double value) { return std::isfinite(value); }))
            fail("{}: array {}: found a number that is not finite, expected only finite numbers", file, name);
        return values;
    }
    IntensityScatterModel read_intensity_scatter() const {
        IntensityScatterModel result;
        const std::vector<double> feature = read_finite_array("feature", "i4"),
                                  values = read_finite_array("values", "f4");
        const std::size_t n = feature.size();
        const std::vector<double> child = read_finite_array("child", "i4", n),
                                  first = read_finite_array("first", "i4", n),
                                  count = read_finite_array("count", "i4", n),
                                  at = read_finite_array("at", "f4", n);
        result.values.assign(values.begin(), values.end());
        for (std::size_t i = 0; i < n; ++i) {
            const bool is_leaf = feature[i] == -1.0,
                       has_feature =
                           feature[i] >= 0.0 &&
                           feature[i]<double(count_intensity_features()), has_children = child[i]> double(
                               i) &&
                           child[i] + 1.0 < double(n),
                       has_values =
                           first[i] >= 0.0 && count[i] > 0.0 && first[i] + count[i] <= double(values.size());
            if (!has_values || !(is_leaf || (has_feature && has_children)))
                fail(
                    "{0}: node {2} of the decision tree for the intensities of LiDAR {1} is invalid (feature "
                    "{3}, first child {4}, first value {5}, {6} values); expected a file that relidar has "
                    "written",
                    file, lidar, i, feature[i], child[i], first[i], count[i]);
            result.nodes.push_back({std::int32_t(feature[i]), float(at[i]), std::int32_t(child[i]),
                                    std::uint32_t(first[i]), std::uint32_t(count[i])});
        }
        result.step = read_finite_array("step", "f8", 1)[0];
        if (result.step < 0.0)
            fail(
                "{0}: the array {1}.step (step between two intensities of LiDAR {1}) contains {2}, expected "
                "0 or a positive number",
                file, lidar, result.step);
        return result;
    }
};

}  // namespace

void save_intensity_scatter(const std::filesystem::path& path,
                            const std::vector<IntensityScatterModel>& scatter_per_lidar) {
    std::vector<NamedArray> arrays;
    for (std::size_t lidar = 0; lidar < scatter_per_lidar.size(); ++lidar)
        if (!scatter_per_lidar[lidar].empty()) append_scatter_arrays(arrays, lidar, scatter_per_lidar[lidar]);
    if (arrays.empty()) return void(std::filesystem::remove(path));
    write_safetensors(
        path, arrays,
        {{"format", kScatterFormat}, {"version", kScatterVersion}, {"relidar", RELIDAR_VERSION}});
}

std::vector<IntensityScatterModel> load_intensity_scatter(const std::filesystem::path& path,
                                                          std::size_t n_lidars) {
    const std::string file = path.string();
    std::map<std::string, std::string> metadata;
    const std::vector<NamedArray> arrays = read_safetensors(path, &metadata);
    require_format_and_version(metadata, file, kScatterFormat, kScatterVersion);
    std::vector<IntensityScatterModel> result(n_lidars);
    for (std::size_t lidar = 0; lidar < n_lidars; ++lidar)
        if (find_array(arrays, fmt::format("{}.feature", lidar)))
            result[lidar] = ScatterArrays{arrays, file, lidar}.read_intensity_scatter();
    return result;
}

}  // namespace relidar::run_detail
