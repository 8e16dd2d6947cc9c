// SPDX-License-Identifier: Apache-2.0
// The classifier against closed forms: what can be told of two normal distributions, of equal ones, and of a pattern that no single feature
// shows.
#include "metrics/boosted_trees.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include <gtest/gtest.h>

#include "core/random.hpp"

namespace relidar::metrics_detail {
namespace {

using Draw = std::function<void(Random&, int label, float* row)>;

LabelledRows drawn(std::size_t n, std::size_t n_features, std::uint64_t seed, const Draw& draw) {
    Random random(seed);
    LabelledRows rows{n_features, std::vector<float>(n * n_features), std::vector<std::uint8_t>(n)};
    for (std::size_t i = 0; i < n; ++i) {
        rows.label[i] = std::uint8_t(i % 2);
        draw(random, int(i % 2), rows.features.data() + i * n_features);
    }
    return rows;
}

/// Normal deviates, those of class 1 shifted by d along the diagonal of the features.
Draw two_normals(std::size_t n_features, double d) {
    return [=](Random& random, int label, float* row) {
        for (std::size_t f = 0; f < n_features; ++f) row[f] = float(random.normal() + label * d / std::sqrt(double(n_features)));
    };
}

std::vector<double> scores(const BoostedTrees& trees, const LabelledRows& rows) {
    std::vector<double> result(rows.size());
    for (std::size_t i = 0; i < result.size(); ++i) result[i] = trees.score(rows.row(i));
    return result;
}

double accuracy(const BoostedTrees& trees, const LabelledRows& rows) {
    std::size_t n_right = 0;
    for (std::size_t i = 0; i < rows.size(); ++i) n_right += (trees.score(rows.row(i)) > 0.0) == (rows.label[i] == 1);
    return double(n_right) / double(rows.size());
}

double normal_cdf(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

/// Standard error of the area under the curve of n rows, half of each class: Hanley and McNeil, Radiology 1982.
double sampling_error(double area, std::size_t n) {
    const double m = double(n) / 2.0, q1 = area / (2.0 - area), q2 = 2.0 * area * area / (1.0 + area);
    return std::sqrt((area * (1.0 - area) + (m - 1.0) * (q1 + q2 - 2.0 * area * area)) / (m * m));
}

TEST(AreaUnderRoc, OfHandComputedScores) {
    EXPECT_DOUBLE_EQ(area_under_roc({1.0, 2.0, 3.0, 4.0}, {0, 0, 1, 1}), 1.0);
    EXPECT_DOUBLE_EQ(area_under_roc({1.0, 2.0, 3.0, 4.0}, {1, 1, 0, 0}), 0.0);
    EXPECT_DOUBLE_EQ(area_under_roc({5.0, 5.0, 5.0}, {0, 1, 0}), 0.5);
    // pairs of a one and a zero: 2 > 1, 2 = 2, 3 > 1, 3 > 2
    EXPECT_DOUBLE_EQ(area_under_roc({3.0, 2.0, 1.0, 2.0}, {1, 0, 0, 1}), 3.5 / 4.0);
}

TEST(AreaUnderRoc, OfTwoNormalsIsTheClosedForm) {
    constexpr std::size_t kRows = 40000;
    for (const double d : {0.0, 0.5, 1.0, 2.0}) {
        const LabelledRows rows = drawn(kRows, 1, 7, two_normals(1, d));
        const double expected = normal_cdf(d / std::sqrt(2.0));
        EXPECT_NEAR(area_under_roc({rows.features.begin(), rows.features.end()}, rows.label), expected,
                    3.0 * sampling_error(expected, kRows))
            << "d " << d;
    }
}

// The best that can be told of two normals d apart has the area Phi(d / sqrt 2); trees of steps, learnt from as many rows, stay below it by
// up to a hundredth and can be above it by chance alone.
TEST(BoostedTrees, TellTwoNormalsAsWellAsTheyCanBeTold) {
    constexpr std::size_t kRows = 20000;
    for (const double d : {0.5, 1.0, 2.0}) {
        const BoostedTrees trees(drawn(kRows, 1, 1, two_normals(1, d)));
        const LabelledRows rows = drawn(kRows, 1, 2, two_normals(1, d));
        const double area = area_under_roc(scores(trees, rows), rows.label), best = normal_cdf(d / std::sqrt(2.0));
        EXPECT_LT(area, best + 3.0 * sampling_error(best, kRows)) << "d " << d;
        EXPECT_GT(area, best - 3.0 * sampling_error(best, kRows) - 0.01) << "d " << d;
        EXPECT_NEAR(accuracy(trees, rows), normal_cdf(d / 2.0), 3.0 * 0.5 / std::sqrt(double(kRows)) + 0.01) << "d " << d;
    }
}

TEST(BoostedTrees, CannotTellEqualSamples) {
    constexpr std::size_t kRows = 8000;
    const double half = double(kRows) / 2.0, error = std::sqrt((2.0 * half + 1.0) / (12.0 * half * half));   // Mann and Whitney
    for (std::uint64_t seed = 0; seed < 4; ++seed) {
        const BoostedTrees trees(drawn(kRows, 5, 2 * seed, two_normals(5, 0.0)));
        const LabelledRows rows = drawn(kRows, 5, 2 * seed + 1, two_normals(5, 0.0));
        EXPECT_NEAR(area_under_roc(scores(trees, rows), rows.label), 0.5, 3.0 * error) << "seed " << seed;
    }
}

// Class 1 where the signs of the first two features differ: neither says anything alone. Two more say nothing.
TEST(BoostedTrees, LearnExclusiveOr) {
    const auto draw = [](Random& random, int label, float* row) {
        for (int f = 0; f < 4; ++f) row[f] = float(random.uniform(-1.0, 1.0));
        if ((row[0] * row[1] < 0.0f) != (label == 1)) row[1] = -row[1];
    };
    const BoostedTrees trees(drawn(8000, 4, 3, draw));
    EXPECT_GT(accuracy(trees, drawn(8000, 4, 4, draw)), 0.97);
}

TEST(BoostedTrees, AreTheSameEveryTime) {
    const LabelledRows rows = drawn(2000, 3, 8, two_normals(3, 1.0));
    EXPECT_EQ(scores(BoostedTrees(rows), rows), scores(BoostedTrees(rows), rows));
}

// Nothing to split by, and a feature that says it all.
TEST(BoostedTrees, OfConstantAndOfPerfectFeatures) {
    const LabelledRows constant = drawn(200, 2, 9, [](Random&, int, float* row) { row[0] = row[1] = 1.0f; });
    for (const double score : scores(BoostedTrees(constant), constant)) EXPECT_EQ(score, 0.0);
    const LabelledRows perfect = drawn(200, 1, 9, [](Random&, int label, float* row) { row[0] = float(label); });
    EXPECT_EQ(accuracy(BoostedTrees(perfect), perfect), 1.0);
}

}  // namespace
}  // namespace relidar::metrics_detail
