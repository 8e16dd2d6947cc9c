// SPDX-License-Identifier: Apache-2.0
// Compares LPIPS with direct loops in double precision for random weights, and with
// published values (../shared/data/lpips; skipped without RELIDAR_SHARED).
#include <relidar/score/metrics.hpp>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

constexpr int kOut[5] = {64, 192, 384, 256, 256}, kIn[5] = {3, 64, 192, 384, 256},
              kEdge[5] = {11, 5, 3, 3, 3};

std::vector<float> make_random_values(std::size_t count, float low, float high, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> uniform(low, high);
    std::vector<float> values(count);
    for (float& v : values) v = uniform(random);
    return values;
}

LpipsWeights make_random_weights() {
    LpipsWeights weights;
    for (unsigned l = 0; l < 5; ++l) {
        const int fan_in = kIn[l] * kEdge[l] * kEdge[l];
        // With this bound, the magnitude of the features is constant from layer to layer.
        const float bound = std::sqrt(6.0f / float(fan_in));
        weights.weight[l] =
            make_random_values(std::size_t(kOut[l]) * std::size_t(fan_in), -bound, bound, 10 + l);
        weights.bias[l] = make_random_values(std::size_t(kOut[l]), -0.1f, 0.1f, 20 + l);
        weights.linear[l] = make_random_values(std::size_t(kOut[l]), 0.0f, 1.0f, 30 + l);
    }
    return weights;
}

struct Planes {
    int channels, rows, columns;
    std::vector<double> values;
    double at(int c, int y, int x) const {
        return values[(std::size_t(c) * std::size_t(rows) + std::size_t(y)) * std::size_t(columns) +
                      std::size_t(x)];
    }
};

Planes convolve(const Planes& in, const LpipsWeights& weights, int layer, int stride, int padding) {
    const int edge = kEdge[layer];
    Planes out{kOut[layer],
               (in.rows + 2 * padding - edge) / stride + 1,
               (in.columns + 2 * padding - edge) / stride + 1,
               {}};
    for (int o = 0; o < out.channels; ++o)
        for (int y = 0; y < out.rows; ++y)
            for (int x = 0; x < out.columns; ++x) {
                double sum = weights.bias[std::size_t(layer)][std::size_t(o)];
                for (int c = 0; c < in.channels; ++c)
                    for (int i = 0; i < edge; ++i)
                        for (int j = 0; j < edge; ++j) {
                            const int v = y * stride + i - padding, u = x * stride + j - padding;
                            if (v < 0 || u < 0 || v >= in.rows || u >= in.columns) continue;
                            sum += double(weights.weight[std::size_t(layer)][std::size_t(
                                       ((o * in.channels + c) * edge + i) * edge + j)]) *
                                   in.at(c, v, u);
                        }
                out.values.push_back(std::max(sum, 0.0));
            }
    return out;
}

Planes pool(const Planes& in) {
    Planes out{in.channels, (in.rows - 3) / 2 + 1, (in.columns - 3) / 2 + 1, {}};
    for (int c = 0; c < out.channels; ++c)
        for (int y = 0; y < out.rows; ++y)
            for (int x = 0; x < out.columns; ++x) {
                double most = in.at(c, 2 * y, 2 * x);
                for (int k = 0; k < 9; ++k) most = std::max(most, in.at(c, 2 * y + k / 3, 2 * x + k % 3));
                out.values.push_back(most);
            }
    return out;
}

std::vector<Planes> compute_reference_features(const std::vector<float>& image, int rows, int columns,
                                               const LpipsWeights& weights) {
    constexpr double shift[3] = {-0.030, -0.088, -0.188}, scale[3] = {0.458, 0.448, 0.450};
    Planes x{3, rows, columns, {}};
    for (std::size_t i = 0; i < image.size(); ++i) {
        const std::size_t colour = i / (image.size() / 3);
        x.values.push_back((double(image[i]) - shift[colour]) / scale[colour]);
    }
    std::vector<Planes> features{convolve(x, weights, 0, 4, 2)};
    features.push_back(convolve(pool(features[0]), weights, 1, 1, 2));
    features.push_back(convolve(pool(features[1]), weights, 2, 1, 1));
    features.push_back(convolve(features[2], weights, 3, 1, 1));
    features.push_back(convolve(features[3], weights, 4, 1, 1));
    return features;
}

double compute_reference_distance(const Planes& first, const Planes& second,
                                  const std::vector<float>& linear) {
    double total = 0.0;
    for (int y = 0; y < first.rows; ++y)
        for (int x = 0; x < first.columns; ++x) {
            double na = 0.0, nb = 0.0;
            for (int c = 0; c < first.channels; ++c) {
                na += first.at(c, y, x) * first.at(c, y, x);
                nb += second.at(c, y, x) * second.at(c, y, x);
            }
            for (int c = 0; c < first.channels; ++c) {
                const double d = first.at(c, y, x) / (std::sqrt(na) + 1e-10) -
                                 second.at(c, y, x) / (std::sqrt(nb) + 1e-10);
                total += double(linear[std::size_t(c)]) * d * d;
            }
        }
    return total / (first.rows * first.columns);
}

TEST(LpipsNetwork, AgreesWithDirectLoops) {
    const LpipsWeights weights = make_random_weights();
    const Lpips lpips(weights);
    for (const auto& [rows, columns] : {std::pair(31, 31), {35, 44}}) {
        const std::size_t n = 3 * std::size_t(rows) * std::size_t(columns);
        const std::vector<float> a = make_random_values(n, -1.0f, 1.0f, 1),
                                 b = make_random_values(n, -3.0f, 5.0f, 2);
        const std::vector<Planes> fa = compute_reference_features(a, rows, columns, weights),
                                  fb = compute_reference_features(b, rows, columns, weights);
        const std::array<double, 5> layer_distances = lpips.layer_distances(a, b, rows, columns);
        for (std::size_t l = 0; l < 5; ++l) {
            const double expected = compute_reference_distance(fa[l], fb[l], weights.linear[l]);
            EXPECT_GT(expected, 0.0);
            EXPECT_NEAR(layer_distances[l], expected, 2e-5 * expected)
                << "layer " << l << " of " << rows << " x " << columns;
        }
    }
}

TEST(LpipsNetwork, OneChannelIsRepeatedAndNotClamped) {
    const Lpips lpips(make_random_weights());
    const std::vector<float> metres = make_random_values(31 * 40, 0.0f, 80.0f, 3),
                             other = make_random_values(31 * 40, 0.0f, 80.0f, 4);
    const auto colours = [](const std::vector<float>& image) {
        std::vector<float> repeated;
        for (int colour = 0; colour < 3; ++colour)
            for (const float v : image) repeated.push_back(2.0f * v - 1.0f);
        return repeated;
    };
    double expected = 0.0;
    for (const double d : lpips.layer_distances(colours(metres), colours(other), 31, 40)) expected += d;
    const std::vector<double> a(metres.begin(), metres.end()), b(other.begin(), other.end());
    EXPECT_NEAR(lpips.compute_distance(a, b, 31, 40), expected, 1e-12);
    EXPECT_EQ(lpips.compute_distance(a, a, 31, 40), 0.0);
}

TEST(LpipsNetwork, RefusesWrongSizes) {
    const LpipsWeights good = make_random_weights();
    const auto refused = [&](auto change) {
        LpipsWeights bad = good;
        change(bad);
        EXPECT_THROW(Lpips{bad}, DataError);
    };
    refused([](LpipsWeights& weights) { weights.weight[3].pop_back(); });
    refused([](LpipsWeights& weights) { weights.bias[0].push_back(0.0f); });
    refused([](LpipsWeights& weights) { weights.linear[4].clear(); });
    refused([](LpipsWeights& weights) { weights.weight[1][7] = std::numeric_limits<float>::quiet_NaN(); });
    const Lpips lpips(good);
    EXPECT_THROW(
        lpips.layer_distances(std::vector<float>(3 * 30 * 40), std::vector<float>(3 * 30 * 40), 30, 40),
        DataError);
    EXPECT_THROW(
        lpips.layer_distances(std::vector<float>(3 * 31 * 40), std::vector<float>(3 * 31 * 39), 31, 40),
        DataError);
}

/// Compares with expected.json of the shared folder. Image a consists of sin(0.1 x + 0.05
/// y), cos(0.07 x - 0.03 y) and sin(0.11 (x + y)). Image b is similar. Both images have
/// 64 x 96 pixels. The published code uses weights in single precision. Our weights are
/// rounded to half precision, a relative error of 2^-11.
TEST(LpipsNetwork, AgreesWithPublishedWeightsAndValues) {
    const char* shared = std::getenv("RELIDAR_SHARED");
    const std::filesystem::path folder =
        shared ? std::filesystem::path(shared)
               : std::filesystem::path(RELIDAR_SOURCE_DIR).parent_path() / "shared";
    const std::filesystem::path file = folder / "data" / "lpips" / "lpips_alex_v0.1_f16.safetensors";
    if (!std::filesystem::exists(file))
        GTEST_SKIP() << file << " is not there; RELIDAR_SHARED names another folder";
    constexpr int n_rows = 64, n_columns = 96;
    const auto image = [](double y0, double y1, double k2) {
        const auto compute_value = [&](int colour, int x, int y) {
            if (colour == 0) return std::sin(0.1 * x + y0 * y);
            if (colour == 1) return std::cos(0.07 * x - y1 * y);
            return std::sin(k2 * (x + y));
        };
        std::vector<float> values;
        for (int colour = 0; colour < 3; ++colour)
            for (int y = 0; y < n_rows; ++y)
                for (int x = 0; x < n_columns; ++x) values.push_back(float(compute_value(colour, x, y)));
        return values;
    };
    const std::array<double, 5> layer_distances =
        Lpips(read_lpips_weights(file))
            .layer_distances(image(0.05, 0.03, 0.11), image(0.08, 0.05, 0.13), n_rows, n_columns);
    const double expected[5] = {0.05731607973575592, 0.03482897952198982, 0.030503420159220695,
                                0.02966426871716976, 0.01576225645840168};
    double sum = 0.0;
    for (std::size_t l = 0; l < 5; ++l) {
        EXPECT_NEAR(layer_distances[l], expected[l], 0x1p-11 * expected[l]) << "layer " << l;
        sum += layer_distances[l];
    }
    EXPECT_NEAR(sum, 0.16807499527931213, 0x1p-11 * 0.168);
}

}  // namespace
}  // namespace relidar
