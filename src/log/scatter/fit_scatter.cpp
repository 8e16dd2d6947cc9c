// SPDX-License-Identifier: Apache-2.0
// Fits a decision tree that predicts intensities to all returns, one layer of nodes after
// the other. Each node is split at the feature and the value that reduce the entropy of
// the classes most. The classes c are 24 quantiles of all intensities:
//   gain = sum n_c ln(n_c / n) of both children - the same sum of the node
// A node is not split if the gain could be due to chance.
#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

#include <relidar/log/scatter.hpp>

#include "base/fail.hpp"
#include "base/joined.hpp"
#include "base/parallel.hpp"
#include "base/parallel_sort.hpp"
#include "base/random.hpp"
#include "log/scatter/ray_features.hpp"

namespace relidar {
namespace {

using scatter::kFeatures;
using scatter::RayFeatureExtractor;
using scatter::RayFeatures;

constexpr std::size_t kMaxReturns = 2000000, kMinReturns = 1000;
constexpr std::size_t kFewestOfLeaf = 50;
// Minimum gain of log-likelihood. Of random intensities, it splits about 1 in 100 nodes.
constexpr double kLeastGain = 20.0;
constexpr std::size_t kClasses = 24, kBins = 64;
constexpr std::size_t kQuantileReturns = 100000;  // number of returns from which quantiles are computed

/// One training return. The class is a quantile of all intensities.
struct ScatterSample {
    std::array<std::uint8_t, kFeatures> bins;
    std::uint8_t intensity_class;
    float value;
};

/// All training samples. Samples in the same tree node are contiguous in memory.
struct ScatterSamples {
    std::vector<ScatterSample> all;
    /// [features] upper ends of all bins except the last
    std::array<std::vector<float>, kFeatures> bin_borders = {};
};

/// Returns the values that divide a list into `n_parts` equal parts, without duplicates.
std::vector<float> find_quantiles(std::vector<float> values, std::size_t n_parts) {
    parallel_sort(values, std::less<>());
    std::vector<float> quantiles;
    for (std::size_t k = 1; k < n_parts; ++k) quantiles.push_back(values[values.size() * k / n_parts]);
    quantiles.erase(std::unique(quantiles.begin(), quantiles.end()), quantiles.end());
    return quantiles;
}

/// Returns the bin of a value. Bin b is above quantile b - 1, up to quantile b.
std::uint8_t find_bin(const std::vector<float>& quantiles, float value) {
    return std::uint8_t(std::lower_bound(quantiles.begin(), quantiles.end(), value) - quantiles.begin());
}

struct ImageRay {
    std::uint32_t image, ray;
};

bool has_both_returns(const PairedIntensities& paired_image, std::size_t ray_index) {
    return paired_image.measured[ray_index] != kNoIntensity &&
           paired_image.rendered.range_m[ray_index] > 0.0f;
}

/// Lists the measured points whose rays also hit a rendered surface, or a random part of
/// about `max_returns` of them.
std::vector<ImageRay> sample_returns(std::span<const PairedIntensities> images, std::size_t max_returns) {
    std::size_t n_returns = 0;
    for (const PairedIntensities& image : images)
        for (std::size_t ray = 0; ray < image.measured.size(); ++ray)
            if (has_both_returns(image, ray)) ++n_returns;
    const double share = double(max_returns) / double(std::max<std::size_t>(n_returns, 1));
    std::vector<std::vector<ImageRay>> samples_of_images(images.size());
    parallel_for(int(images.size()), [&](int index) {
        const auto image = std::size_t(index);
        for (std::size_t ray = 0; ray < images[image].measured.size(); ++ray) {
            if (!has_both_returns(images[image], ray)) continue;
            // The seed depends only on the ray, so that threads do not change the choice.
            if (Random(hash_pair(image, ray)).sample_uniform() < share)
                samples_of_images[image].push_back({std::uint32_t(image), std::uint32_t(ray)});
        }
    });
    return concatenate(std::move(samples_of_images));
}

RayFeatures return_features(std::span<const PairedIntensities> images, ImageRay return_index) {
    const PairedIntensities& image = images[return_index.image];
    const int columns = image.rendered.columns, ray = int(return_index.ray);
    return RayFeatureExtractor(image.rendered, image.measured).compute_features(ray / columns, ray % columns);
}

/// Computes the borders of the bins of each feature: quantiles of every `stride`-th
/// return, so that each bin holds a similar number of returns.
/// @return [features] upper ends of all bins except the last
std::array<std::vector<float>, kFeatures> find_bin_borders(std::span<const PairedIntensities> images,
                                                           const std::vector<ImageRay>& returns) {
    const std::size_t stride = returns.size() / kQuantileReturns + 1;
    std::vector<RayFeatures> some_features((returns.size() + stride - 1) / stride);
    parallel_blocks(some_features.size(), [&](std::size_t index) {
        some_features[index] = return_features(images, returns[index * stride]);
    });
    std::array<std::vector<float>, kFeatures> borders;
    parallel_for(int(kFeatures), [&](int feature) {
        std::vector<float> values;
        for (const RayFeatures& features : some_features) values.push_back(features[std::size_t(feature)]);
        borders[std::size_t(feature)] = find_quantiles(std::move(values), kBins);
    });
    return borders;
}

/// Computes the feature bins and the intensity class of each return. Classes are bins of
/// the intensity that hold similar numbers of returns.
ScatterSamples make_samples(std::span<const PairedIntensities> images, const std::vector<ImageRay>& returns) {
    ScatterSamples samples{.all = std::vector<ScatterSample>(returns.size()),
                           .bin_borders = find_bin_borders(images, returns)};
    std::vector<float> intensities;
    for (const ImageRay& place : returns) intensities.push_back(images[place.image].measured[place.ray]);
    const std::vector<float> class_borders = find_quantiles(intensities, kClasses);
    parallel_blocks(returns.size(), [&](std::size_t index) {
        const RayFeatures features = return_features(images, returns[index]);
        ScatterSample& sample = samples.all[index];
        for (std::size_t f = 0; f < kFeatures; ++f)
            sample.bins[f] = find_bin(samples.bin_borders[f], features[f]);
        sample.intensity_class = find_bin(class_borders, intensities[index]);
        sample.value = intensities[index];
    });
    return samples;
}

/// Returns a table of k ln k for the integers k: the terms of the entropy of a node.
std::vector<double> make_entropy_terms(std::size_t max_count) {
    std::vector<double> terms(max_count + 1, 0.0);
    for (std::size_t k = 1; k <= max_count; ++k) terms[k] = double(k) * std::log(double(k));
    return terms;
}

/// Number of returns in each class.
struct ClassCounts {
    std::array<std::uint32_t, kClasses> of{};

    std::uint32_t count_returns() const { return std::accumulate(of.begin(), of.end(), 0u); }
    void add_counts(const ClassCounts& other) {
        for (std::size_t c = 0; c < kClasses; ++c) of[c] += other.of[c];
    }
    /// Returns the sum of n_c ln(n_c / n).
    double log_likelihood(const std::vector<double>& k_log_k_table) const {
        double sum = -k_log_k_table[count_returns()];
        for (const std::uint32_t k : of) sum += k_log_k_table[k];
        return sum;
    }
};

/// The first child gets the returns whose feature value is in bin `bin` or lower. Feature
/// -1: no split has a gain above kLeastGain.
struct TreeNodeSplit {
    double gain = kLeastGain;
    int feature = -1;
    std::size_t bin = 0;
    std::uint32_t n_first = 0;  ///< number of returns of the first child
};

// Number of features whose histograms fit into the first-level cache.
constexpr std::size_t kFeaturesPerPass = 4;
using BinCounts = std::array<ClassCounts, kBins>;

/// Returns the best split of a tree node by one feature: tries all borders between bins.
/// The gain is the increase of sum n_c ln(n_c / n) over the classes c (top of this file).
/// @param class_counts_by_bin number of returns of each class in each bin of the feature
/// @param n_bin_borders number of bins except the last
/// @param k_log_k_table make_entropy_terms()
TreeNodeSplit split_by_feature(const BinCounts& class_counts_by_bin, std::size_t feature,
                               std::size_t n_bin_borders, const std::vector<double>& k_log_k_table) {
    TreeNodeSplit best;
    ClassCounts node, first_child;
    for (const ClassCounts& bin_counts : class_counts_by_bin) node.add_counts(bin_counts);
    const std::uint32_t n_node = node.count_returns();
    const double node_likelihood = node.log_likelihood(k_log_k_table);
    std::uint32_t n_first = 0;
    for (std::size_t bin = 0; bin < n_bin_borders; ++bin) {
        const std::uint32_t n_in_bin = class_counts_by_bin[bin].count_returns();
        if (n_in_bin == 0) continue;  // the same split as at the border before this bin
        first_child.add_counts(class_counts_by_bin[bin]);
        n_first += n_in_bin;
        if (n_first < kFewestOfLeaf || n_node - n_first < kFewestOfLeaf) continue;
        ClassCounts second_child = node;
        for (std::size_t c = 0; c < kClasses; ++c) second_child.of[c] -= first_child.of[c];
        const double gain = first_child.log_likelihood(k_log_k_table) +
                            second_child.log_likelihood(k_log_k_table) - node_likelihood;
        if (gain > best.gain) best = {.gain = gain, .feature = int(feature), .bin = bin, .n_first = n_first};
    }
    return best;
}

/// Returns the best split by one of kFeaturesPerPass features from `first_feature`.
TreeNodeSplit split_by_features(const ScatterSamples& samples, std::span<const ScatterSample> node_samples,
                                std::size_t first_feature, const std::vector<double>& k_log_k_table) {
    const std::size_t n_features = std::min(kFeaturesPerPass, kFeatures - first_feature);
    std::array<BinCounts, kFeaturesPerPass> counts{};  // [features, bins, classes]
    for (const ScatterSample& sample : node_samples)
        for (std::size_t f = 0; f < n_features; ++f)
            ++counts[f][sample.bins[first_feature + f]].of[sample.intensity_class];
    TreeNodeSplit best;
    for (std::size_t f = 0; f < n_features; ++f) {
        const std::size_t feature = first_feature + f;
        const TreeNodeSplit split =
            split_by_feature(counts[f], feature, samples.bin_borders[feature].size(), k_log_k_table);
        if (split.gain > best.gain) best = split;
    }
    return best;
}

/// Returns the best split of a tree node by any feature. If two splits are equally good,
/// uses the one with the lower feature index.
TreeNodeSplit find_node_split(const ScatterSamples& samples, const std::vector<double>& k_log_k_table,
                              const IntensityScatterModel::DecisionTreeNode& node) {
    constexpr std::size_t kMinLargeNode = 65536;
    TreeNodeSplit best;
    if (node.count < 2 * kFewestOfLeaf) return best;  // stays a leaf
    const auto node_samples = std::span(samples.all).subspan(node.first, node.count);
    // Best split of each group of kFeaturesPerPass features.
    std::array<TreeNodeSplit, (kFeatures + kFeaturesPerPass - 1) / kFeaturesPerPass> group_splits;
    const auto split_by_group = [&](int group) {
        const std::size_t first_feature = std::size_t(group) * kFeaturesPerPass;
        group_splits[std::size_t(group)] =
            split_by_features(samples, node_samples, first_feature, k_log_k_table);
    };
    // The first layers have few nodes, so their large nodes need more threads than one.
    if (node.count >= kMinLargeNode) parallel_for(int(group_splits.size()), split_by_group);
    else
        for (int group = 0; group < int(group_splits.size()); ++group) split_by_group(group);
    for (const TreeNodeSplit& split : group_splits)
        if (split.gain > best.gain) best = split;
    return best;
}

/// Splits the last layer of the decision tree, which is all nodes from index `first_node`
/// on. Appends their children, which form the next layer. A node without a useful split
/// stays a leaf. Reorders `samples`, so that those of each child are contiguous.
void split_layer(ScatterSamples& samples, const std::vector<double>& k_log_k_table,
                 std::vector<IntensityScatterModel::DecisionTreeNode>& nodes, std::size_t first_node) {
    // Entry k belongs to node first_node + k. The nodes of a layer share no samples, so
    // they are split in parallel.
    std::vector<TreeNodeSplit> splits(nodes.size() - first_node);
    parallel_for(int(splits.size()), [&](int k) {
        const IntensityScatterModel::DecisionTreeNode& node = nodes[first_node + std::size_t(k)];
        TreeNodeSplit& split = splits[std::size_t(k)];
        split = find_node_split(samples, k_log_k_table, node);
        if (split.feature < 0) return;  // stays a leaf
        const auto node_samples = std::span(samples.all).subspan(node.first, node.count);
        std::stable_partition(node_samples.begin(), node_samples.end(), [&](const ScatterSample& sample) {
            return sample.bins[std::size_t(split.feature)] <= split.bin;
        });
    });
    // Appends the children in the order of nodes, so that threads do not change it.
    for (std::size_t k = 0; k < splits.size(); ++k) {
        const TreeNodeSplit& split = splits[k];
        if (split.feature < 0) continue;
        IntensityScatterModel::DecisionTreeNode& node = nodes[first_node + k];
        node.feature = split.feature;
        node.at = samples.bin_borders[std::size_t(split.feature)][split.bin];
        node.child = std::int32_t(nodes.size());
        // push_back() moves the nodes in memory, so `node` is not used after it.
        const std::uint32_t begin = node.first, count = node.count;
        nodes.push_back({.first = begin, .count = split.n_first});
        nodes.push_back({.first = begin + split.n_first, .count = count - split.n_first});
    }
}

/// Checks that all arrays of an image have one value for each ray.
void check_image_sizes(std::span<const PairedIntensities> images) {
    for (const auto& [image, measured] : images) {
        const std::size_t n_rays = std::size_t(image.rows) * std::size_t(image.columns);
        for (const std::size_t size : {image.intensity.size(), image.range_m.size(), image.spread_m.size(),
                                       image.cosine.size(), image.elevation_rad.size(), measured.size()})
            if (size != n_rays)
                fail("cannot fit the intensity scatter: found an array of {} values, expected {} x {}", size,
                     image.rows, image.columns);
    }
}

/// Returns the greatest common divisor of two real numbers by Euclid's algorithm.
/// Remainders below `tolerance` count as zero.
double approximate_gcd(double first, double second, double tolerance) {
    while (second > tolerance) {
        const double rest = std::abs(std::remainder(first, second));
        first = second;
        second = rest;
    }
    return first;
}

}  // namespace

double find_step(std::vector<float> values) {
    constexpr double kMaxRelativeError = 1e-6,
                     kMinRelativeStep = 1e-5;  // Both values are relative to the largest intensity.
    constexpr std::size_t kFewestLevels = 8;
    parallel_sort(values, std::less<>());
    values.erase(std::unique(values.begin(), values.end()), values.end());
    if (values.size() < kFewestLevels || values.front() < 0.0f) return 0.0;
    const double largest = double(values.back());
    double step = 0.0;
    // The step is the greatest common divisor of all values, refined after each value.
    for (const float value : values) {
        // The step is 0 before the first value and after a value of 0.
        step = step > 0.0 ? approximate_gcd(double(value), step, kMaxRelativeError * largest) : double(value);
        if (value > 0.0f && step < kMinRelativeStep * largest) return 0.0;
        // `value` is an integer multiple of the step, n * step. Recomputes the step as
        // value / n, because a larger n gives a more accurate step.
        if (step > 0.0) step = double(value) / std::round(double(value) / step);
    }
    const auto is_multiple = [&](float v) {
        return std::abs(std::remainder(double(v), step)) <= kMaxRelativeError * largest;
    };
    return std::ranges::all_of(values, is_multiple) ? step : 0.0;
}

float IntensityScatterModel::quantise(float intensity) const {
    return step > 0.0 ? static_cast<float>(std::round(double(intensity) / step) * step) : intensity;
}

IntensityScatterModel fit_scatter(std::span<const PairedIntensities> images) {
    check_image_sizes(images);
    const std::vector<ImageRay> return_locations = sample_returns(images, kMaxReturns);
    IntensityScatterModel result;
    if (return_locations.size() < kMinReturns) return result;
    ScatterSamples samples = make_samples(images, return_locations);
    result.nodes = {{.first = 0, .count = std::uint32_t(return_locations.size())}};
    const std::vector<double> k_log_k_table = make_entropy_terms(return_locations.size());
    // The first layer is the root. Ends when a layer has appended no nodes.
    std::size_t layer_begin = 0;
    while (layer_begin < result.nodes.size()) {
        const std::size_t layer_end = result.nodes.size();
        split_layer(samples, k_log_k_table, result.nodes, layer_begin);
        layer_begin = layer_end;
    }
    // Leaves refer to ranges of the samples, which split_layer() has reordered.
    for (const ScatterSample& sample : samples.all) result.values.push_back(sample.value);
    result.step = find_step(result.values);
    return result;
}

}  // namespace relidar
