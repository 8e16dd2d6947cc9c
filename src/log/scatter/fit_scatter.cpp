// SPDX-License-Identifier: Apache-2.0
// Fits a decision tree for intensities to all returns, one layer of nodes after the
// other. Each node is split at the feature and the value that reduce the entropy of the
// classes most. The classes c are 24 quantiles of all intensities:
//   gain = sum n_c ln(n_c / n) of both children - the same sum of the node
// A node is not split if the gain could be due to chance.
#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/scatter.hpp>

#include "base/joined.hpp"
#include "base/parallel.hpp"
#include "base/parallel_sort.hpp"
#include "base/random.hpp"
#include "log/scatter/ray_features.hpp"

namespace relidar {
namespace {

using scatter_detail::Context;
using scatter_detail::Features;
using scatter_detail::kFeatures;

constexpr std::size_t kMostReturns = 2000000, kFewestReturns = 1000;
constexpr std::size_t kFewestOfLeaf = 50;
// A node of the decision tree is split only if the log-likelihood gains more than this.
// For unrelated features, twice the gain is chi-square distributed with 23 degrees of
// freedom. The best split then exceeds the limit in 1 of 100 cases.
constexpr double kLeastGain = 20.0;
constexpr std::size_t kClasses = 24, kBins = 64;
constexpr std::size_t kQuantileReturns = 100000;  // number of returns from which quantiles are computed

/// Features (as bin numbers), class and intensity of one return.
struct Return {
    std::array<std::uint8_t, kFeatures> bins;
    std::uint8_t of_class;
    float value;
};

/// All returns of the scans. Returns of a tree node are contiguous in memory, so that
/// counting them reads memory sequentially.
struct Returns {
    std::vector<Return> all;
    std::array<std::vector<float>, kFeatures> cuts = {};  ///< upper ends of all bins except the last
};

/// Returns the quantiles that divide a list into `count` parts of equal size, without
/// duplicates.
std::vector<float> compute_quantiles(std::vector<float> values, std::size_t count) {
    parallel_sort(values, std::less<>());
    std::vector<float> cuts;
    for (std::size_t k = 1; k < count; ++k) cuts.push_back(values[values.size() * k / count]);
    cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
    return cuts;
}

std::uint8_t find_bin(const std::vector<float>& cuts, float value) {
    return std::uint8_t(std::lower_bound(cuts.begin(), cuts.end(), value) - cuts.begin());
}

/// Position of a return: index of its image, and index of its ray.
struct ReturnPlace {
    std::uint32_t image, ray;
};

bool is_return(const MeasuredIntensities& image, std::size_t ray) {
    return image.measured[ray] != kNoIntensity && image.rendered.range_m[ray] > 0.0f;
}

/// Returns the measured returns whose rays also hit a rendered surface. If there are too
/// many, selects about `max_count` of them at random.
std::vector<ReturnPlace> list_return_places(std::span<const MeasuredIntensities> images,
                                            std::size_t max_count) {
    std::size_t n = 0;
    for (const MeasuredIntensities& image : images)
        for (std::size_t i = 0; i < image.measured.size(); ++i) n += is_return(image, i);
    const double share = double(max_count) / double(std::max<std::size_t>(n, 1));
    std::vector<std::vector<ReturnPlace>> of_images(images.size());
    parallel_for(int(images.size()), [&](int image) {
        const auto k = std::size_t(image);
        for (std::size_t i = 0; i < images[k].measured.size(); ++i)
            if (is_return(images[k], i) && Random(combine_hashes(k, i)).uniform() < share)
                of_images[k].push_back({std::uint32_t(k), std::uint32_t(i)});
    });
    return concatenate(std::move(of_images));
}

Features compute_features(std::span<const MeasuredIntensities> images, ReturnPlace location) {
    const MeasuredIntensities& image = images[location.image];
    const int columns = image.rendered.columns, ray = int(location.ray);
    return Context(image.rendered, image.measured).of(ray / columns, ray % columns);
}

Returns read_returns(std::span<const MeasuredIntensities> images, const std::vector<ReturnPlace>& places) {
    Returns result{std::vector<Return>(places.size())};
    const std::size_t stride = places.size() / kQuantileReturns + 1;
    std::vector<Features> some((places.size() + stride - 1) / stride);
    for_each_block(some.size(), [&](std::size_t index) {
        some[index] = compute_features(images, places[index * stride]);
    });
    parallel_for(int(kFeatures), [&](int f) {
        std::vector<float> values;
        for (const Features& features : some) values.push_back(features[std::size_t(f)]);
        result.cuts[std::size_t(f)] = compute_quantiles(std::move(values), kBins);
    });
    std::vector<float> values;
    for (const ReturnPlace& place : places) values.push_back(images[place.image].measured[place.ray]);
    const std::vector<float> classes = compute_quantiles(values, kClasses);
    for_each_block(places.size(), [&](std::size_t index) {
        const Features features = compute_features(images, places[index]);
        Return& one = result.all[index];
        for (std::size_t f = 0; f < kFeatures; ++f) one.bins[f] = find_bin(result.cuts[f], features[f]);
        one.of_class = find_bin(classes, values[index]);
        one.value = values[index];
    });
    return result;
}

/// Table of k ln k for integers.
class Terms {
public:
    explicit Terms(std::size_t max_count) : of_(max_count + 1, 0.0) {
        for (std::size_t k = 1; k <= max_count; ++k) of_[k] = double(k) * std::log(double(k));
    }
    double operator()(std::uint32_t k) const { return of_[k]; }

private:
    std::vector<double> of_;
};

/// Number of returns in each class.
struct Counts {
    std::array<std::uint32_t, kClasses> of{};

    std::uint32_t n() const { return std::accumulate(of.begin(), of.end(), 0u); }
    void add(const Counts& other) {
        for (std::size_t c = 0; c < kClasses; ++c) of[c] += other.of[c];
    }
    Counts subtract_counts(const Counts& other) const {
        Counts rest = *this;
        for (std::size_t c = 0; c < kClasses; ++c) rest.of[c] -= other.of[c];
        return rest;
    }
    /// Returns the sum of n_c ln(n_c / n).
    double compute_order(const Terms& terms) const {
        double sum = -terms(n());
        for (const std::uint32_t k : of) sum += terms(k);
        return sum;
    }
};

/// Split of a tree node. The first child gets the returns whose feature value is in bin
/// `bin` or a lower bin.
struct Cut {
    double gain = kLeastGain;
    int feature = -1;
    std::size_t bin = 0;
};

// Number of features that one pass counts. Their counts fit into the first-level cache.
constexpr std::size_t kTogether = 4;
using Bins = std::array<Counts, kBins>;

/// Returns the best split of a tree node by one feature.
/// @param counts  number of returns of each class in each bin of the feature
Cut find_best_feature_split(const Bins& counts, std::size_t feature, std::size_t n_cuts, const Terms& terms) {
    Cut best;
    Counts all, low;
    for (const Counts& of_bin : counts) all.add(of_bin);
    const std::uint32_t n = all.n();
    const double before = all.compute_order(terms);
    std::uint32_t n_low = 0;
    for (std::size_t b = 0; b < n_cuts; ++b) {
        const std::uint32_t of_bin = counts[b].n();
        // Splits before and after an empty bin are equal, so one of them is skipped.
        if (of_bin == 0) continue;
        low.add(counts[b]);
        n_low += of_bin;
        if (n_low < kFewestOfLeaf || n - n_low < kFewestOfLeaf) continue;
        const double gain = low.compute_order(terms) + all.subtract_counts(low).compute_order(terms) - before;
        if (gain > best.gain) best = {gain, int(feature), b};
    }
    return best;
}

/// Returns the best split of a tree node by a few consecutive features, from `first` on.
Cut find_best_split_among(const Returns& returns, std::span<const Return> node_returns, std::size_t first,
                          const Terms& terms) {
    const std::size_t n = std::min(kTogether, kFeatures - first);
    std::array<Bins, kTogether> counts{};
    for (const Return& one : node_returns)
        for (std::size_t f = 0; f < n; ++f) ++counts[f][one.bins[first + f]].of[one.of_class];
    Cut best;
    for (std::size_t f = 0; f < n; ++f)
        if (const Cut cut =
                find_best_feature_split(counts[f], first + f, returns.cuts[first + f].size(), terms);
            cut.gain > best.gain)
            best = cut;
    return best;
}

/// Returns the best split of a tree node. Of equally good splits, returns the one with
/// the lowest feature index.
/// @param each function that runs a task for 0, 1, ..., n - 1
template <class Each>
Cut find_best_node_split(const Returns& returns, std::span<const Return> node_returns, const Terms& terms,
                         const Each& each) {
    Cut best;
    if (node_returns.size() < 2 * kFewestOfLeaf) return best;
    std::array<Cut, (kFeatures + kTogether - 1) / kTogether> cuts;
    each(int(cuts.size()), [&](int k) {
        cuts[std::size_t(k)] =
            find_best_split_among(returns, node_returns, std::size_t(k) * kTogether, terms);
    });
    for (const Cut& cut : cuts)
        if (cut.gain > best.gain) best = cut;
    return best;
}

/// Finds the best splits of several tree nodes in parallel. The features of large nodes
/// are also processed in parallel.
std::vector<Cut> find_best_layer_splits(const Returns& returns, const Terms& terms,
                                        std::span<const IntensityScatter::Node> nodes) {
    constexpr std::size_t kLarge = 65536;
    std::vector<Cut> cuts(nodes.size());
    const auto part = [&](std::size_t index) {
        return std::span(returns.all).subspan(nodes[index].first, nodes[index].count);
    };
    parallel_for(int(nodes.size()), [&](int k) {
        const bool is_large = nodes[std::size_t(k)].count >= kLarge;
        cuts[std::size_t(k)] =
            find_best_node_split(returns, part(std::size_t(k)), terms, [&](int count, const auto& task) {
                if (is_large) return parallel_for(count, task);
                for (int i = 0; i < count; ++i) task(i);
            });
    });
    return cuts;
}

/// Splits the tree nodes from index `first` on. A node with too little gain stays a leaf.
/// Reorders the returns so that those of each child are contiguous.
void split_layer(Returns& returns, const Terms& terms, std::vector<IntensityScatter::Node>& nodes,
                 std::size_t first) {
    const std::vector<Cut> cuts = find_best_layer_splits(returns, terms, std::span(nodes).subspan(first));
    std::vector<std::uint32_t> n_low(cuts.size(), 0);
    parallel_for(int(cuts.size()), [&](int k) {
        const Cut& cut = cuts[std::size_t(k)];
        if (cut.feature < 0) return;
        const IntensityScatter::Node& node = nodes[first + std::size_t(k)];
        const auto own = std::span(returns.all).subspan(node.first, node.count);
        const auto is_low = [&](const Return& one) { return one.bins[std::size_t(cut.feature)] <= cut.bin; };
        n_low[std::size_t(k)] =
            std::uint32_t(std::stable_partition(own.begin(), own.end(), is_low) - own.begin());
    });
    for (std::size_t k = 0; k < cuts.size(); ++k) {
        if (cuts[k].feature < 0) continue;
        IntensityScatter::Node& node = nodes[first + k];
        node.feature = cuts[k].feature;
        node.at = returns.cuts[std::size_t(cuts[k].feature)][cuts[k].bin];
        node.child = std::int32_t(nodes.size());
        const std::uint32_t begin = node.first, count = node.count;
        nodes.push_back({.first = begin, .count = n_low[k]});
        nodes.push_back({.first = begin + n_low[k], .count = count - n_low[k]});
    }
}

void check_sizes(std::span<const MeasuredIntensities> images) {
    for (const auto& [r, measured] : images) {
        const std::size_t n = std::size_t(r.rows) * std::size_t(r.columns);
        for (const std::size_t size : {r.intensity.size(), r.range_m.size(), r.spread_m.size(),
                                       r.cosine.size(), r.elevation_rad.size(), measured.size()})
            if (size != n)
                throw DataError(fmt::format(
                    "cannot fit the scatter of intensities: found an array of {} rays, expected {} x {}",
                    size, r.rows, r.columns));
    }
}

/// Returns the greatest common divisor of two real numbers (Euclid). Remainders below
/// `error` count as zero.
double find_common_divisor(double first, double second, double error) {
    while (second > error) {
        const double rest = std::abs(std::remainder(first, second));
        first = second;
        second = rest;
    }
    return first;
}

}  // namespace

double find_quantisation_step(std::vector<float> values) {
    constexpr double kError = 1e-6, kFinest = 1e-5;  // Both values are relative to the largest intensity.
    constexpr std::size_t kFewestLevels = 8;
    parallel_sort(values, std::less<>());
    values.erase(std::unique(values.begin(), values.end()), values.end());
    if (values.size() < kFewestLevels || values.front() < 0.0f) return 0.0;
    const double largest = double(values.back());
    double step = 0.0;
    for (const float value : values) {
        step = step > 0.0 ? find_common_divisor(double(value), step, kError * largest) : double(value);
        if (value > 0.0f && step < kFinest * largest) return 0.0;
        // Refines the step with the current value. Values ascend, so the step becomes
        // more and more accurate.
        if (step > 0.0) step = double(value) / std::round(double(value) / step);
    }
    const auto is_multiple = [&](float v) {
        return std::abs(std::remainder(double(v), step)) <= kError * largest;
    };
    return std::ranges::all_of(values, is_multiple) ? step : 0.0;
}

float IntensityScatter::round_to_step(float intensity) const {
    return step > 0.0 ? static_cast<float>(std::round(double(intensity) / step) * step) : intensity;
}

IntensityScatter fit_scatter(std::span<const MeasuredIntensities> images) {
    check_sizes(images);
    const std::vector<ReturnPlace> places = list_return_places(images, kMostReturns);
    IntensityScatter result;
    if (places.size() < kFewestReturns) return result;
    Returns returns = read_returns(images, places);
    result.nodes = {{.first = 0, .count = std::uint32_t(places.size())}};
    const Terms terms(places.size());
    for (std::size_t first = 0; first < result.nodes.size();) {
        const std::size_t end = result.nodes.size();
        split_layer(returns, terms, result.nodes, first);
        first = end;
    }
    for (const Return& one : returns.all) result.values.push_back(one.value);
    result.step = find_quantisation_step(result.values);
    return result;
}

}  // namespace relidar
