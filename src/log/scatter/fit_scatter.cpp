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
// Minimum gain in log-likelihood of a split. About 1 in 100 nodes of random intensities
// is split by chance.
constexpr double kLeastGain = 20.0;
constexpr std::size_t kClasses = 24, kBins = 64;
constexpr std::size_t kQuantileReturns = 100000;  // number of returns from which quantiles are computed

/// One training return: the bin of each feature, the intensity class, and the intensity.
struct ScatterSample {
    std::array<std::uint8_t, kFeatures> bins;
    std::uint8_t of_class;
    float value;
};

/// All training samples. Samples in the same tree node are contiguous in memory.
struct ScatterSamples {
    std::vector<ScatterSample> all;
    std::array<std::vector<float>, kFeatures> cuts = {};  ///< upper ends of all bins except the last
};

/// Returns the values that divide a list into `n_parts` equal parts, without duplicates.
std::vector<float> find_quantiles(std::vector<float> values, std::size_t n_parts) {
    parallel_sort(values, std::less<>());
    std::vector<float> cuts;
    for (std::size_t k = 1; k < n_parts; ++k) cuts.push_back(values[values.size() * k / n_parts]);
    cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
    return cuts;
}

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
    std::size_t n = 0;
    for (const PairedIntensities& image : images)
        for (std::size_t i = 0; i < image.measured.size(); ++i) n += has_both_returns(image, i);
    const double share = double(max_returns) / double(std::max<std::size_t>(n, 1));
    std::vector<std::vector<ImageRay>> of_images(images.size());
    parallel_for(int(images.size()), [&](int image) {
        const auto k = std::size_t(image);
        for (std::size_t i = 0; i < images[k].measured.size(); ++i)
            if (has_both_returns(images[k], i) && Random(hash_pair(k, i)).sample_uniform() < share)
                of_images[k].push_back({std::uint32_t(k), std::uint32_t(i)});
    });
    return concatenate(std::move(of_images));
}

RayFeatures return_features(std::span<const PairedIntensities> images, ImageRay return_index) {
    const PairedIntensities& image = images[return_index.image];
    const int columns = image.rendered.columns, ray = int(return_index.ray);
    return RayFeatureExtractor(image.rendered, image.measured).compute_features(ray / columns, ray % columns);
}

/// Computes the feature bins and the intensity class of each return. The bins are
/// quantiles, so that each holds a similar number of returns.
ScatterSamples make_samples(std::span<const PairedIntensities> images, const std::vector<ImageRay>& indices) {
    ScatterSamples result{std::vector<ScatterSample>(indices.size())};
    const std::size_t stride = indices.size() / kQuantileReturns + 1;
    std::vector<RayFeatures> some((indices.size() + stride - 1) / stride);
    parallel_blocks(some.size(), [&](std::size_t index) {
        some[index] = return_features(images, indices[index * stride]);
    });
    parallel_for(int(kFeatures), [&](int f) {
        std::vector<float> values;
        for (const RayFeatures& features : some) values.push_back(features[std::size_t(f)]);
        result.cuts[std::size_t(f)] = find_quantiles(std::move(values), kBins);
    });
    std::vector<float> values;
    for (const ImageRay& location : indices) values.push_back(images[location.image].measured[location.ray]);
    const std::vector<float> classes = find_quantiles(values, kClasses);
    parallel_blocks(indices.size(), [&](std::size_t index) {
        const RayFeatures features = return_features(images, indices[index]);
        ScatterSample& one = result.all[index];
        for (std::size_t f = 0; f < kFeatures; ++f) one.bins[f] = find_bin(result.cuts[f], features[f]);
        one.of_class = find_bin(classes, values[index]);
        one.value = values[index];
    });
    return result;
}

/// Table of k ln k for integers.
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

/// The first child gets the returns whose feature value is in bin `bin` or lower.
struct TreeNodeSplit {
    double gain = kLeastGain;
    int feature = -1;
    std::size_t bin = 0;
};

// Number of features whose histograms fit into the first-level cache.
constexpr std::size_t kFeaturesPerPass = 4;
using BinCounts = std::array<ClassCounts, kBins>;

/// Returns the best split of a tree node by one feature.
/// @param class_counts_by_bin number of returns of each class in each bin of the feature
TreeNodeSplit split_by_feature(const BinCounts& class_counts_by_bin, std::size_t feature,
                               std::size_t n_bin_borders, const std::vector<double>& k_log_k_table) {
    TreeNodeSplit best;
    ClassCounts all, low;
    for (const ClassCounts& of_bin : class_counts_by_bin) all.add_counts(of_bin);
    const std::uint32_t n = all.count_returns();
    const double before = all.log_likelihood(k_log_k_table);
    std::uint32_t n_low = 0;
    for (std::size_t b = 0; b < n_bin_borders; ++b) {
        const std::uint32_t of_bin = class_counts_by_bin[b].count_returns();
        if (of_bin == 0) continue;  // the same split as before this bin
        low.add_counts(class_counts_by_bin[b]);
        n_low += of_bin;
        if (n_low < kFewestOfLeaf || n - n_low < kFewestOfLeaf) continue;
        ClassCounts high = all;
        for (std::size_t c = 0; c < kClasses; ++c) high.of[c] -= low.of[c];
        const double gain = low.log_likelihood(k_log_k_table) + high.log_likelihood(k_log_k_table) - before;
        if (gain > best.gain) best = {gain, int(feature), b};
    }
    return best;
}

/// Returns the best split by one of kFeaturesPerPass features from `first_feature`.
TreeNodeSplit split_by_features(const ScatterSamples& samples, std::span<const ScatterSample> node_samples,
                                std::size_t first_feature, const std::vector<double>& k_log_k_table) {
    const std::size_t n = std::min(kFeaturesPerPass, kFeatures - first_feature);
    std::array<BinCounts, kFeaturesPerPass> counts{};
    for (const ScatterSample& one : node_samples)
        for (std::size_t f = 0; f < n; ++f) ++counts[f][one.bins[first_feature + f]].of[one.of_class];
    TreeNodeSplit best;
    for (std::size_t f = 0; f < n; ++f)
        if (const TreeNodeSplit cut = split_by_feature(counts[f], first_feature + f,
                                                       samples.cuts[first_feature + f].size(), k_log_k_table);
            cut.gain > best.gain)
            best = cut;
    return best;
}

/// Returns the best split of each tree node. If two splits are equally good, uses the one
/// with the lower feature index. For large nodes, also processes the features in
/// parallel.
std::vector<TreeNodeSplit> find_layer_splits(const ScatterSamples& samples,
                                             const std::vector<double>& k_log_k,
                                             std::span<const IntensityScatterModel::DecisionTreeNode> nodes) {
    constexpr std::size_t kMinLargeNode = 65536;
    std::vector<TreeNodeSplit> best(nodes.size());
    parallel_for(int(nodes.size()), [&](int index) {
        const IntensityScatterModel::DecisionTreeNode& node = nodes[std::size_t(index)];
        const auto node_samples = std::span(samples.all).subspan(node.first, node.count);
        if (node.count < 2 * kFewestOfLeaf) return;
        // Best split of each group of kFeaturesPerPass features.
        std::array<TreeNodeSplit, (kFeatures + kFeaturesPerPass - 1) / kFeaturesPerPass> cuts;
        const auto find_cut = [&](int k) {
            cuts[std::size_t(k)] =
                split_by_features(samples, node_samples, std::size_t(k) * kFeaturesPerPass, k_log_k);
        };
        if (node.count >= kMinLargeNode) parallel_for(int(cuts.size()), find_cut);
        else
            for (int k = 0; k < int(cuts.size()); ++k) find_cut(k);
        for (const TreeNodeSplit& cut : cuts)
            if (cut.gain > best[std::size_t(index)].gain) best[std::size_t(index)] = cut;
    });
    return best;
}

/// Splits the nodes of the decision tree with index `first_node` or higher. Reorders
/// `samples` so that those of each node stay contiguous.
void split_layer(ScatterSamples& samples, const std::vector<double>& k_log_k_table,
                 std::vector<IntensityScatterModel::DecisionTreeNode>& nodes, std::size_t first_node) {
    const std::vector<TreeNodeSplit> cuts =
        find_layer_splits(samples, k_log_k_table, std::span(nodes).subspan(first_node));
    std::vector<std::uint32_t> n_low(cuts.size(), 0);
    parallel_for(int(cuts.size()), [&](int k) {
        const TreeNodeSplit& cut = cuts[std::size_t(k)];
        if (cut.feature < 0) return;
        const IntensityScatterModel::DecisionTreeNode& node = nodes[first_node + std::size_t(k)];
        const auto node_samples = std::span(samples.all).subspan(node.first, node.count);
        const auto is_low = [&](const ScatterSample& one) {
            return one.bins[std::size_t(cut.feature)] <= cut.bin;
        };
        // Moves the samples of the first child to the front.
        n_low[std::size_t(k)] = std::uint32_t(
            std::stable_partition(node_samples.begin(), node_samples.end(), is_low) - node_samples.begin());
    });
    for (std::size_t k = 0; k < cuts.size(); ++k) {
        if (cuts[k].feature < 0) continue;
        IntensityScatterModel::DecisionTreeNode& node = nodes[first_node + k];
        node.feature = cuts[k].feature;
        node.at = samples.cuts[std::size_t(cuts[k].feature)][cuts[k].bin];
        node.child = std::int32_t(nodes.size());
        const std::uint32_t begin = node.first, count = node.count;
        nodes.push_back({.first = begin, .count = n_low[k]});
        nodes.push_back({.first = begin + n_low[k], .count = count - n_low[k]});
    }
}

void check_image_sizes(std::span<const PairedIntensities> images) {
    for (const auto& [r, measured] : images) {
        const std::size_t n = std::size_t(r.rows) * std::size_t(r.columns);
        for (const std::size_t size : {r.intensity.size(), r.range_m.size(), r.spread_m.size(),
                                       r.cosine.size(), r.elevation_rad.size(), measured.size()})
            if (size != n)
                fail("cannot fit the intensity scatter: found an array of {} values, expected {} x {}", size,
                     r.rows, r.columns);
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
    for (const float value : values) {
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
    const std::vector<double> terms = make_entropy_terms(return_locations.size());
    // A layer is the nodes that the split of the previous layer has appended.
    for (std::size_t first = 0; first < result.nodes.size();) {
        const std::size_t end = result.nodes.size();
        split_layer(samples, terms, result.nodes, first);
        first = end;
    }
    // Leaves refer to ranges of the samples, which split_layer() has reordered.
    for (const ScatterSample& one : samples.all) result.values.push_back(one.value);
    result.step = find_step(result.values);
    return result;
}

}  // namespace relidar
