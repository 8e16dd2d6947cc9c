// SPDX-License-Identifier: Apache-2.0
#include "boosted_trees.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace relidar::metrics_detail {
namespace {

constexpr int kTrees = 150;
constexpr int kDepth = 8;               // deep enough to cut out the steps in which sensors tell intensities
constexpr int kBins = 255;              // of a feature; their numbers fit a byte
constexpr double kLearningRate = 0.1;
constexpr double kLeastHessian = 5.0;   // of a leaf: 20 rows of which nothing is known yet, each p (1 - p) = 1/4
constexpr double kEmpty = 1e-9;         // a bin's hessian where differences of sums leave no row in it

/// Features as numbers of bins, column by column.
struct BinnedColumns {
    std::vector<std::vector<float>> edges;           ///< [features][bins - 1] ascending; a value falls into the bin of the first edge that
                                                     ///< is not below it
    std::vector<std::vector<std::uint8_t>> bins;     ///< [features][rows]
};

/// Edges between bins: halfway between neighbouring values where there are few, else such that every bin has about as many rows.
std::vector<float> bin_edges(std::vector<float> values) {
    std::sort(values.begin(), values.end());
    std::vector<float> distinct = values;
    distinct.erase(std::unique(distinct.begin(), distinct.end()), distinct.end());
    const std::vector<float>& of = distinct.size() <= std::size_t(kBins) ? distinct : values;
    const std::size_t n_bins = std::min(distinct.size(), std::size_t(kBins));
    std::vector<float> edges;
    for (std::size_t b = 1; b < n_bins; ++b) {
        const std::size_t i = b * of.size() / n_bins;
        const float edge = 0.5f * (of[i - 1] + of[i]);
        if (edges.empty() || edge > edges.back()) edges.push_back(edge);
    }
    return edges;
}

BinnedColumns bin_columns(const LabelledRows& rows) {
    BinnedColumns result;
    for (std::size_t f = 0; f < rows.n_features; ++f) {
        std::vector<float> values(rows.size());
        for (std::size_t i = 0; i < values.size(); ++i) values[i] = rows.row(i)[f];
        const std::vector<float>& edges = result.edges.emplace_back(bin_edges(values));
        std::vector<std::uint8_t>& bins = result.bins.emplace_back(rows.size());
        for (std::size_t i = 0; i < values.size(); ++i)
            bins[i] = std::uint8_t(std::lower_bound(edges.begin(), edges.end(), values[i]) - edges.begin());
    }
    return result;
}

/// First and second derivative of the loss by the score, summed over rows.
struct Sums {
    double gradient = 0.0, hessian = 0.0;

    void add(const Sums& other) { gradient += other.gradient, hessian += other.hessian; }
    Sums without(const Sums& other) const { return {gradient - other.gradient, hessian - other.hessian}; }
    /// Twice what the best constant takes off the loss.
    double gain() const { return gradient * gradient / hessian; }
    /// Whether it may be split in two.
    bool is_divisible() const { return hessian >= 2.0 * kLeastHessian; }
};
using Histogram = std::vector<Sums>;   ///< [features][kBins]

/// Rows go to the left up to the last bin of it.
struct Split {
    double gain = 0.0;
    std::size_t feature = 0;
    int last_left = -1;   ///< -1: there is no split worth making
    Sums left;            ///< of the rows there
};

/// Grows one tree and moves the scores by it.
class TreeGrower {
public:
    TreeGrower(const BinnedColumns& columns, const std::vector<Sums>& of_row, std::vector<double>& score)
        : columns_(columns), of_row_(of_row), score_(score), rows_(score.size()) {
        std::iota(rows_.begin(), rows_.end(), 0u);
    }

    BoostedTrees::Tree grow() {
        tree_.resize(1);
        Sums all;
        for (const Sums& row : of_row_) all.add(row);
        grow({0, 0, rows_.size(), all, 0}, all.is_divisible() ? histogram(0, rows_.size()) : Histogram{});
        return std::move(tree_);
    }

private:
    /// A node that is not finished.
    struct Part {
        std::size_t node, begin, end;   ///< in the tree; its rows
        Sums all;
        int depth;

        bool may_split() const { return depth < kDepth && all.is_divisible(); }
    };

    const BinnedColumns& columns_;
    const std::vector<Sums>& of_row_;
    std::vector<double>& score_;
    std::vector<std::uint32_t> rows_;   ///< those of a node are neighbours
    BoostedTrees::Tree tree_;

    Histogram histogram(std::size_t begin, std::size_t end) const {
        Histogram sums(columns_.bins.size() * kBins);
        for (std::size_t f = 0; f < columns_.bins.size(); ++f) {
            const std::uint8_t* bin = columns_.bins[f].data();
            Sums* const of_feature = sums.data() + f * kBins;
            for (std::size_t i = begin; i < end; ++i) of_feature[bin[rows_[i]]].add(of_row_[rows_[i]]);
        }
        return sums;
    }

    Split best_split(const Histogram& sums, const Sums& all) const {
        Split best;
        for (std::size_t f = 0; f < columns_.bins.size(); ++f) {
            Sums left;
            for (int b = 0; b < int(columns_.edges[f].size()); ++b) {
                const Sums& bin = sums[f * kBins + std::size_t(b)];
                if (bin.hessian < kEmpty) continue;   // the same split as the one before
                left.add(bin);
                const Sums right = all.without(left);
                if (left.hessian < kLeastHessian) continue;
                if (right.hessian < kLeastHessian) break;
                const double gain = left.gain() + right.gain() - all.gain();
                if (gain > best.gain) best = {gain, f, b, left};
            }
        }
        return best;
    }

    /// @param sums  of the part, where it may split
    void grow(const Part& part, Histogram sums) {
        const Split split = part.may_split() ? best_split(sums, part.all) : Split{};
        if (split.last_left < 0) return end_in_leaf(part);
        const auto goes_left = [&](std::uint32_t row) { return int(columns_.bins[split.feature][row]) <= split.last_left; };
        const auto first = rows_.begin() + std::ptrdiff_t(part.begin), last = rows_.begin() + std::ptrdiff_t(part.end);
        const std::size_t middle = std::size_t(std::stable_partition(first, last, goes_left) - rows_.begin());
        const std::size_t child = tree_.size();
        tree_.resize(child + 2);
        tree_[part.node] = {int(child), int(split.feature), columns_.edges[split.feature][std::size_t(split.last_left)], 0.0};
        const Part left{child, part.begin, middle, split.left, part.depth + 1};
        const Part right{child + 1, middle, part.end, part.all.without(split.left), part.depth + 1};

        Histogram of_small;   // the smaller part is summed, the other is what remains
        const bool left_is_small = left.end - left.begin < right.end - right.begin;
        if (left.may_split() || right.may_split()) {
            const Part& small = left_is_small ? left : right;
            of_small = histogram(small.begin, small.end);
            for (std::size_t i = 0; i < sums.size(); ++i) sums[i] = sums[i].without(of_small[i]);
        }
        grow(left, left_is_small ? std::move(of_small) : std::move(sums));
        grow(right, left_is_small ? std::move(sums) : std::move(of_small));
    }

    void end_in_leaf(const Part& part) {
        const double value = -kLearningRate * part.all.gradient / part.all.hessian;
        tree_[part.node].value = value;
        for (std::size_t i = part.begin; i < part.end; ++i) score_[rows_[i]] += value;
    }
};

}  // namespace

BoostedTrees::BoostedTrees(const LabelledRows& rows) {
    const BinnedColumns columns = bin_columns(rows);
    const double n = double(rows.size()), n_ones = double(std::count(rows.label.begin(), rows.label.end(), 1));
    start_ = std::log(n_ones / (n - n_ones));
    std::vector<double> score(rows.size(), start_);
    std::vector<Sums> of_row(rows.size());
    for (int t = 0; t < kTrees; ++t) {
        for (std::size_t i = 0; i < of_row.size(); ++i) {
            const double p = 1.0 / (1.0 + std::exp(-score[i]));
            of_row[i] = {p - double(rows.label[i]), p * (1.0 - p)};
        }
        trees_.push_back(TreeGrower(columns, of_row, score).grow());
    }
}

double BoostedTrees::score(const float* row) const {
    double sum = start_;
    for (const Tree& tree : trees_) {
        std::size_t at = 0;
        while (tree[at].left >= 0) at = std::size_t(tree[at].left) + (row[tree[at].feature] <= tree[at].threshold ? 0 : 1);
        sum += tree[at].value;
    }
    return sum;
}

double area_under_roc(const std::vector<double>& score, const std::vector<std::uint8_t>& label) {
    std::vector<std::size_t> order(score.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return score[a] < score[b]; });
    double wins = 0.0, zeros = 0.0, ones = 0.0;
    for (std::size_t begin = 0; begin < order.size();) {
        double equal_zeros = 0.0, equal_ones = 0.0;
        std::size_t end = begin;
        for (; end < order.size() && score[order[end]] == score[order[begin]]; ++end) (label[order[end]] ? equal_ones : equal_zeros) += 1.0;
        wins += equal_ones * (zeros + 0.5 * equal_zeros);
        zeros += equal_zeros;
        ones += equal_ones;
        begin = end;
    }
    return wins / (zeros * ones);
}

}  // namespace relidar::metrics_detail
