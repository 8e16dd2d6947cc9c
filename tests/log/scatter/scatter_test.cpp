// SPDX-License-Identifier: Apache-2.0
// Values drawn from a fitted tree must have the distribution of the simulated sensor.

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/log/scatter.hpp>

#include "base/random.hpp"
#include "log/scatter/ray_features.hpp"

namespace relidar {
namespace {

constexpr int kRows = 16, kColumns = 256;
constexpr std::size_t kRays = std::size_t(kRows) * kColumns;

/// Panels of 16 columns each with a rendered brightness of 0.2, 0.4, 0.6 or 0.8.
RenderedIntensityImage make_panels() {
    RenderedIntensityImage image{kRows,
                                 kColumns,
                                 {},
                                 std::vector<float>(kRays, 10.0f),
                                 std::vector<float>(kRays, 0.0f),
                                 std::vector<float>(kRays, 1.0f),
                                 {}};
    for (int row = 0; row < kRows; ++row)
        for (int column = 0; column < kColumns; ++column) {
            image.intensity.push_back(0.2f * float(1 + (column / 16 + 3 * row) % 4));
            image.elevation_rad.push_back(-0.01f * float(row));
        }
    return image;
}

/// measure(intensity, residual of the left neighbour, random) returns a measured value.
template <class Measure>
PairedIntensities measured(std::uint64_t seed, const Measure& measure) {
    PairedIntensities result{make_panels(), {}};
    Random random(seed);
    double before = 0.0;
    for (std::size_t i = 0; i < kRays; ++i) {
        const double rendered = double(result.rendered.intensity[i]),
                     value = measure(rendered, i % kColumns == 0 ? 0.0 : before, random);
        before = value - rendered;
        result.measured.push_back(random.sample_uniform() < 0.1 ? kNoIntensity : static_cast<float>(value));
    }
    return result;
}

template <class Measure>
std::vector<PairedIntensities> make_scans(int count, const Measure& measure) {
    std::vector<PairedIntensities> scans;
    for (int k = 0; k < count; ++k) scans.push_back(measured(std::uint64_t(k), measure));
    return scans;
}

const std::vector<std::uint8_t> kAll(kRays, 1);

/// Returns the rendered value, rounded to 0.01, plus (heads - n / 2) / 100, for n fair
/// coins: 4, or 16 on bright panels.
double coins(double rendered, double, Random& random) {
    const int n = rendered > 0.7 ? 16 : 4;
    int heads = 0;
    for (int k = 0; k < n; ++k) heads += random.sample_uniform() < 0.5;
    return (std::round(100.0 * rendered) + heads - n / 2) / 100.0;
}

double compute_binomial(int count, int k) {
    return std::exp(std::lgamma(count + 1.0) - std::lgamma(k + 1.0) - std::lgamma(count - k + 1.0)) *
           std::pow(0.5, count);
}

TEST(Scatter, DrawsTheDistributionOfEachBrightness) {
    const IntensityScatterModel scatter = fit_scatter(make_scans(60, coins));
    ASSERT_FALSE(scatter.empty());
    EXPECT_NEAR(scatter.step, 0.01, 1e-8);
    const RenderedIntensityImage image = make_panels();
    for (const int panel : {1, 2, 3, 4}) {
        const int n = panel == 4 ? 16 : 4;
        std::vector<double> counts(std::size_t(n) + 1, 0.0);
        double drawn = 0.0;
        for (std::uint64_t seed = 1; seed <= 4; ++seed) {
            const std::vector<float> one = draw_intensities(scatter, image, kAll, seed);
            for (std::size_t i = 0; i < kRays; ++i) {
                if (std::abs(image.intensity[i] - 0.2f * float(panel)) > 0.01f) continue;
                const int k = int(std::lround(100.0f * one[i])) - 20 * panel + n / 2;
                ASSERT_TRUE(k >= 0 && k <= n) << one[i] << " on panel " << panel;
                counts[std::size_t(k)] += 1.0;
                drawn += 1.0;
            }
        }
        double chi_square = 0.0, degrees = -1.0;
        for (int k = 0; k <= n; ++k) {
            const double expected = drawn * compute_binomial(n, k);
            if (expected < 20.0) continue;
            chi_square += std::pow(counts[std::size_t(k)] - expected, 2) / expected;
            degrees += 1.0;
        }
        EXPECT_LT(chi_square, degrees + 4.0 * std::sqrt(2.0 * degrees))
            << "panel " << panel << ", " << degrees << " degrees of freedom";
    }
}

/// Autoregressive noise e(i) = 0.8 e(i-1) + 0.03 n, with a variance of 0.0025, and a
/// correlation of 0.8^k between rays k columns apart.
double grain(double rendered, double before, Random& random) {
    return rendered + 0.8 * before + 0.03 * random.sample_normal();
}

TEST(Scatter, IsCorrelatedAlongABeam) {
    const IntensityScatterModel scatter = fit_scatter(make_scans(100, grain));
    EXPECT_EQ(scatter.step, 0.0) << "a continuous log stays continuous";
    EXPECT_EQ(scatter.quantise(0.123456f), 0.123456f);
    const RenderedIntensityImage image = make_panels();
    std::array<double, 4> products{};
    double n = 0.0;
    for (std::uint64_t seed = 1; seed <= 8; ++seed) {
        const std::vector<float> drawn = draw_intensities(scatter, image, kAll, seed);
        for (std::size_t i = 0; i < kRays; ++i) {
            if (i % kColumns < 32) continue;  // the process starts at 0
            for (std::size_t lag = 0; lag < products.size(); ++lag)
                products[lag] +=
                    double(drawn[i] - image.intensity[i]) * double(drawn[i - lag] - image.intensity[i - lag]);
            n += 1.0;
        }
    }
    EXPECT_NEAR(std::sqrt(products[0] / n), 0.05, 0.004);
    EXPECT_NEAR(products[1] / products[0], 0.8, 0.06);
    EXPECT_NEAR(products[2] / products[0], 0.64, 0.08);
    EXPECT_NEAR(products[3] / products[0], 0.512, 0.1);
}

/// Returns a value uniformly distributed between 0.5 and 1.5 times the rendered value.
double even(double rendered, double, Random& random) { return rendered * random.sample_uniform(0.5, 1.5); }

TEST(Scatter, ContinuousDrawsFollowTheirDistributionFunction) {
    const IntensityScatterModel scatter = fit_scatter(make_scans(60, even));
    const RenderedIntensityImage image = make_panels();
    const std::vector<float> drawn = draw_intensities(scatter, image, kAll, 5);
    for (const int panel : {1, 2, 3, 4}) {
        std::vector<double> shares;  // position between 0.5 and 1.5
        for (std::size_t i = 0; i < kRays; ++i)
            if (std::abs(image.intensity[i] - 0.2f * float(panel)) < 0.01f)
                shares.push_back(double(drawn[i] / image.intensity[i]) - 0.5);
        std::sort(shares.begin(), shares.end());
        double farthest = 0.0;
        for (std::size_t k = 0; k < shares.size(); ++k)
            farthest = std::max(farthest, std::abs(shares[k] - (double(k) + 0.5) / double(shares.size())));
        // exceeded by chance in 1 of 1000 runs
        EXPECT_LT(farthest, 1.95 / std::sqrt(double(shares.size())))
            << "Kolmogorov and Smirnov, panel " << panel;
    }
}

TEST(Scatter, TheSeedReproducesAndDroppedRaysHaveNone) {
    const IntensityScatterModel scatter = fit_scatter(make_scans(10, coins)),
                                again = fit_scatter(make_scans(10, coins));
    EXPECT_EQ(scatter.values, again.values);
    std::vector<std::uint8_t> returns(kRays);
    for (std::size_t i = 0; i < kRays; ++i) returns[i] = i % 3 != 0;
    const std::vector<float> drawn = draw_intensities(scatter, make_panels(), returns, 9);
    EXPECT_EQ(drawn, draw_intensities(again, make_panels(), returns, 9));
    EXPECT_NE(drawn, draw_intensities(scatter, make_panels(), returns, 10));
    for (std::size_t i = 0; i < kRays; ++i) ASSERT_EQ(drawn[i] == kNoIntensity, i % 3 == 0) << i;
}

RenderedIntensityImage crop_image(const RenderedIntensityImage& image, int rows, int columns) {
    const auto cut = [&](const std::vector<float>& values) {
        std::vector<float> part;
        for (int row = 0; row < rows; ++row) {
            const auto first = values.begin() + std::ptrdiff_t(row) * image.columns;
            part.insert(part.end(), first, first + columns);
        }
        return part;
    };
    return {rows,
            columns,
            cut(image.intensity),
            cut(image.range_m),
            cut(image.spread_m),
            cut(image.cosine),
            cut(image.elevation_rad)};
}

/// Tiles of an image are drawn in parallel. The widths give a narrow last tile, a single
/// tile, and a tile narrower than the columns ahead.
TEST(Scatter, IsDrawnAsOneRayAfterTheOther) {
    const IntensityScatterModel scatter = fit_scatter(make_scans(40, grain));
    for (const auto& [rows, columns] :
         {std::pair(kRows, kColumns), {kRows, 129}, {kRows, 64}, {1, kColumns}, {kRows, 2}}) {
        const RenderedIntensityImage image = crop_image(make_panels(), rows, columns);
        std::vector<float> expected(image.intensity.size(), kNoIntensity);
        const scatter::RayFeatureExtractor context(image, expected);
        for (std::size_t i = 0; i < expected.size(); ++i) {
            const scatter::RayFeatures features =
                context.compute_features(int(i) / columns, int(i) % columns);
            const IntensityScatterModel::DecisionTreeNode* node = &scatter.nodes[0];
            while (node->feature >= 0)
                node = &scatter.nodes[std::size_t(node->child) +
                                      (features[std::size_t(node->feature)] <= node->at ? 0 : 1)];
            expected[i] = scatter.values[node->first + std::size_t(Random(hash_pair(11, i)).sample_uniform() *
                                                                   double(node->count))];
        }
        const std::vector<std::uint8_t> all(expected.size(), 1);
        for (int repetition = 0; repetition < 20; ++repetition)
            ASSERT_EQ(draw_intensities(scatter, image, all, 11), expected) << rows << " x " << columns;
    }
}

/// In less than a full turn, a ray of the last column does not see the first columns.
TEST(Scatter, WindowsEnd) {
    RenderedIntensityImage image = make_panels();
    std::vector<float> known(kRays, 0.5f);
    const scatter::RayFeatureExtractor features(image, known);
    for (const bool circular : {true, false}) {
        image.circular = circular;
        const scatter::RayFeatures before = features.compute_features(8, kColumns - 1);
        for (std::size_t row = 0; row < kRows; ++row)
            image.intensity[row * kColumns] = known[row * kColumns] += 0.1f;
        EXPECT_EQ(features.compute_features(8, kColumns - 1) == before, !circular);
    }
}

TEST(Scatter, FewReturnsTellNothingAndSizesAreChecked) {
    PairedIntensities image = measured(1, coins);
    std::fill(image.measured.begin() + 900, image.measured.end(), kNoIntensity);
    EXPECT_TRUE(fit_scatter(std::vector{image}).empty());
    EXPECT_TRUE(fit_scatter({}).empty());
    image.rendered.cosine.pop_back();
    EXPECT_THROW(fit_scatter(std::vector{image}), DataError);
}

TEST(Scatter, FindsTheStepOfALog) {
    const auto multiples = [](double step, int count) {
        std::vector<float> values;  // not sorted
        for (int k = 0; k < count; ++k) values.push_back(static_cast<float>(step * double(7 * k % count)));
        return values;
    };
    EXPECT_NEAR(find_step(multiples(0.01, 100)), 0.01, 1e-8);
    EXPECT_NEAR(find_step(multiples(1.0 / 255.0, 256)), 1.0 / 255.0, 1e-8);
    EXPECT_NEAR(find_step(multiples(1.0 / 65535.0, 65536)), 1.0 / 65535.0, 1e-10);
    EXPECT_NEAR(find_step({0.06f, 0.1f, 0.14f, 0.22f, 0.3f, 0.42f, 0.6f, 0.66f}), 0.02, 1e-8)
        << "their divisor, though none lies so near";
    EXPECT_EQ(find_step({0.0f, 0.5f, 1.0f}), 0.0) << "too few to tell";
    EXPECT_EQ(find_step({}), 0.0);
    std::vector<float> almost = multiples(0.01, 100);
    almost.push_back(0.12345678f);
    EXPECT_EQ(find_step(almost), 0.0);
    std::vector<float> continuous;
    Random random(3);
    for (int k = 0; k < 5000; ++k) continuous.push_back(static_cast<float>(random.sample_uniform()));
    EXPECT_EQ(find_step(continuous), 0.0);
    IntensityScatterModel scatter;
    scatter.step = 0.01;
    EXPECT_EQ(scatter.quantise(0.3749f), 0.37f);
    EXPECT_EQ(scatter.quantise(0.0f), 0.0f);
}

}  // namespace
}  // namespace relidar
