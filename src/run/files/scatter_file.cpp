// SPDX-License-Identifier: Apache-2.0
// Reads and writes the statistical intensity models of a run's LiDARs as a safetensors
// file.
#include "run/files/scatter_file.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <string>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "run/files/file_format.hpp"

namespace relidar::run_detail {
namespace {

constexpr const char* kScatterFormat = "relidar intensity scatter";
constexpr const char* kScatterVersion = "1";

using Node = IntensityScatter::Node;

template <class Value>
NamedArray find_array_by_name(const std::string& name, const std::vector<Value>& values) {
    return make_array(name, {values.size()}, values.data(), values.size());
}

void add_arrays(std::vector<NamedArray>& arrays, std::size_t lidar, const IntensityScatter& scatter) {
    std::vector<std::int32_t> feature, child, first, count;
    std::vector<float> at;
    for (const Node& node : scatter.nodes) {
        feature.push_back(node.feature);
        child.push_back(node.child);
        first.push_back(std::int32_t(node.first));
        count.push_back(std::int32_t(node.count));
        at.push_back(node.at);
    }
    const auto name = [&](const char* description) { return fmt::format("{}.{}", lidar, description); };
    arrays.push_back(find_array_by_name(name("feature"), feature));
    arrays.push_back(find_array_by_name(name("child"), child));
    arrays.push_back(find_array_by_name(name("first"), first));
    arrays.push_back(find_array_by_name(name("count"), count));
    arrays.push_back(find_array_by_name(name("at"), at));
    arrays.push_back(find_array_by_name(name("values"), scatter.values));
    arrays.push_back(find_array_by_name(name("step"), std::vector{scatter.step}));
}

/// Reads the arrays that describe the intensity noise of one LiDAR.
struct ScatterArrays {
    const std::vector<NamedArray>& arrays;
    const std::string& file;
    const std::size_t lidar;

    /// Reads an array of `count` finite numbers. If `count` is 0, the array may have any
    /// length.
    std::vector<double> read(const char* description, const char* dtype, std::size_t count = 0) const {
        const std::string name = fmt::format("{}.{}", lidar, description);
        const NamedArray* array = find_array(arrays, name);
        if (!array) throw DataError(fmt::format("{}: array {} is missing", file, name));
        if (array->dtype != dtype || array->shape.size() != 1 || array->count() == 0 ||
            (count > 0 && array->count() != count))
            throw DataError(fmt::format("{}: array {}: found type {} with {} numbers, expected {}{}", file,
                                        name, array->dtype, array->count(), dtype,
                                        count > 0 ? fmt::format(" with {} numbers", count) : ""));
        std::vector<double> values = array->as_double();
        if (!std::ranges::all_of(values, [](double value) { return std::isfinite(value); }))
            throw DataError(fmt::format(
                "{}: array {}: found a number that is not finite, expected only finite numbers", file, name));
        return values;
    }
    IntensityScatter read() const {
        IntensityScatter result;
        const std::vector<double> feature = read("feature", "i4"), values = read("values", "f4");
        const std::size_t n = feature.size();
        const std::vector<double> child = read("child", "i4", n), first = read("first", "i4", n),
                                  count = read("count", "i4", n), at = read("at", "f4", n);
        result.values.assign(values.begin(), values.end());
        for (std::size_t i = 0; i < n; ++i) {
            const bool is_leaf = feature[i] == -1.0,
                       has_feature =
                           feature[i] >= 0.0 &&
                           feature[i]<double(count_scatter_features()), has_children = child[i]> double(i) &&
                           child[i] + 1.0 < double(n),
                       has_values =
                           first[i] >= 0.0 && count[i] > 0.0 && first[i] + count[i] <= double(values.size());
            if (!has_values || !(is_leaf || (has_feature && has_children)))
                throw DataError(fmt::format(
                    "{}: LiDAR {}: node {} of the intensity tree is invalid: feature {}, first child {}, "
                    "first value {}, {} values",
                    file, lidar, i, feature[i], child[i], first[i], count[i]));
            result.nodes.push_back({std::int32_t(feature[i]), float(at[i]), std::int32_t(child[i]),
                                    std::uint32_t(first[i]), std::uint32_t(count[i])});
        }
        result.step = read("step", "f8", 1)[0];
        if (result.step < 0.0)
            throw DataError(
                fmt::format("{}: array {}.step: found {}, expected 0 or more", file, lidar, result.step));
        return result;
    }
};

}  // namespace

void save_scatter(const std::filesystem::path& path, const std::vector<IntensityScatter>& scatter) {
    std::vector<NamedArray> arrays;
    for (std::size_t lidar = 0; lidar < scatter.size(); ++lidar)
        if (!scatter[lidar].empty()) add_arrays(arrays, lidar, scatter[lidar]);
    if (arrays.empty()) return void(std::filesystem::remove(path));
    write_safetensors(
        path, arrays,
        {{"format", kScatterFormat}, {"version", kScatterVersion}, {"relidar", RELIDAR_VERSION}});
}

std::vector<IntensityScatter> load_scatter(const std::filesystem::path& path, std::size_t n_lidars) {
    const std::string file = path.string();
    std::map<std::string, std::string> metadata;
    const std::vector<NamedArray> arrays = read_safetensors(path, &metadata);
    check_format(metadata, file, kScatterFormat, kScatterVersion);
    std::vector<IntensityScatter> result(n_lidars);
    for (std::size_t lidar = 0; lidar < n_lidars; ++lidar)
        if (find_array(arrays, fmt::format("{}.feature", lidar)))
            result[lidar] = ScatterArrays{arrays, file, lidar}.read();
    return result;
}

}  // namespace relidar::run_detail
