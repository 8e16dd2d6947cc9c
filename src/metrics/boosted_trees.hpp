// SPDX-License-Identifier: Apache-2.0
// A classifier of two classes for rows of numbers, to find out whether they can be told apart. Private to metrics.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace relidar::metrics_detail {

/// Rows of features, each of class 0 or 1.
struct LabelledRows {
    std::size_t n_features = 0;
    std::vector<float> features;        ///< [rows][n_features], finite
    std::vector<std::uint8_t> label;    ///< [rows] 0 or 1

    std::size_t size() const { return label.size(); }
    const float* row(std::size_t i) const { return features.data() + i * n_features; }
};

/// Gradient-boosted decision trees (Friedman, Annals of Statistics 2001) for the logistic loss, with Newton steps in the leaves and splits
/// between the bins of a histogram of each feature (Chen and Guestrin, KDD 2016). Nothing in it is random.
///   score(x) = sum over trees of the leaf that x falls into;  P(class 1) = 1 / (1 + exp(-score))
class BoostedTrees {
public:
    /// Learns from both classes. Features that a row lacks are told by the caller, as a value of their own.
    explicit BoostedTrees(const LabelledRows& rows);
    /// Log odds of class 1. @param row [n_features]
    double score(const float* row) const;

    /// A place in a tree: rows whose feature is at most the threshold go to `left`, others to the node after it.
    struct Node {
        int left = -1;            ///< -1: a leaf
        int feature = 0;
        float threshold = 0.0f;
        double value = 0.0;       ///< of a leaf
    };
    using Tree = std::vector<Node>;   ///< [0] the root

private:
    double start_ = 0.0;   ///< log odds of all rows
    std::vector<Tree> trees_;
};

/// Area under the curve of the receiver operating characteristic: how often a row of class 1 scores higher than one of class 0, an equal
/// score counted half (Mann and Whitney). @param score, label [n], of both classes
double area_under_roc(const std::vector<double>& score, const std::vector<std::uint8_t>& label);

}  // namespace relidar::metrics_detail
