// SPDX-License-Identifier: Apache-2.0
// Uploads images of the double reference as a slice of a larger tensor. The remaining
// channels of the tensor must not change.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <ostream>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "../../reference/layers.hpp"
#include "diff/network/layers.hpp"

namespace relidar::test {

using reference::ImageBatch;

struct ImageCase {
    network::ImageBatchSize grid;
    int channels;
};
inline void PrintTo(const ImageCase& test_case, std::ostream* out) {
    *out << test_case.grid.n << "x" << test_case.grid.rows << "x" << test_case.grid.columns << ", "
         << test_case.channels;
}

inline std::vector<double> make_random_floats(std::size_t count, std::uint64_t seed, double scale = 1.0,
                                              double offset = 0.0) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    std::vector<double> values(count);
    for (double& x : values) x = double(float(offset + scale * normal(random)));
    return values;
}

inline ImageBatch make_random_images(network::ImageBatchSize grid, int channels, std::uint64_t seed,
                                     double scale = 1.0, double offset = 0.0) {
    ImageBatch images(int(grid.n), channels, int(grid.rows), int(grid.columns), grid.circular);
    images.values = make_random_floats(images.values.size(), seed, scale, offset);
    return images;
}

inline network::ImageBatchSize get_grid(const ImageBatch& images) {
    return {std::uint32_t(images.n), std::uint32_t(images.rows), std::uint32_t(images.columns),
            images.circular};
}

template <class Meaning = void>
Array<float, Meaning> to_device(Device& device, const std::vector<double>& values) {
    const std::vector<float> floats(values.begin(), values.end());
    return {device, floats, "values"};
}

template <class Meaning = void>
Array<glm::vec2, Meaning> upload_pairs(Device& device, const std::vector<double>& x,
                                       const std::vector<double>& y) {
    std::vector<glm::vec2> pairs;
    for (std::size_t i = 0; i < x.size(); ++i) pairs.emplace_back(float(x[i]), float(y[i]));
    return {device, pairs, "pairs"};
}

inline std::vector<double> to_doubles(const Array<float>& values) {
    const std::vector<float> floats = values.download();
    return {floats.begin(), floats.end()};
}

inline void upload(const network::Tensor& tensor, const std::vector<float>& values) {
    const_cast<network::Tensor&>(tensor).values.upload(values);
}
inline void upload(const network::Tensor& tensor, const std::vector<double>& values) {
    upload(tensor, std::vector<float>(values.begin(), values.end()));
}

class OnDevice {
public:
    /// @param before,after number of channels before and after the images
    OnDevice(Device& device, const ImageBatch& images, std::uint32_t before = 2, std::uint32_t after = 1)
        : tensor_(device, before + std::uint32_t(images.channels) + after, get_grid(images), "images"),
          before_(before),
          shape_(images) {
        std::vector<float> values(tensor_.channels * tensor_.grid.n_pixels_total(), kGuard);
        for_slice([&](std::size_t in_tensor, std::size_t in_slice) {
            values[in_tensor] = float(images.values[in_slice]);
        });
        upload(tensor_, values);
    }
    static OnDevice make_unwritten(Device& device, network::ImageBatchSize grid, int channels,
                                   std::uint32_t before = 1, std::uint32_t after = 2) {
        ImageBatch images(int(grid.n), channels, int(grid.rows), int(grid.columns), grid.circular);
        for (double& x : images.values) x = std::nan("");
        return OnDevice(device, images, before, after);
    }

    network::Slice slice() const { return tensor_.channel_range(before_, std::uint32_t(shape_.channels)); }
    ImageBatch read() const {
        std::vector<float> values = tensor_.values.download();
        ImageBatch images = shape_;
        for_slice([&](std::size_t in_tensor, std::size_t in_slice) {
            images.values[in_slice] = double(values[in_tensor]);
            values[in_tensor] = kGuard;
        });
        std::size_t changed = 0;
        for (const float x : values) changed += x != kGuard;
        EXPECT_EQ(changed, 0u) << "values of neighbouring channels were written";
        return images;
    }

private:
    static constexpr float kGuard = 12344.0f;
    network::Tensor tensor_;
    std::uint32_t before_;
    ImageBatch shape_;

    template <class Visit>
    void for_slice(Visit&& visit) const {
        const std::size_t pixels = shape_.pixels();
        for (int image = 0; image < shape_.n; ++image)
            for (int c = 0; c < shape_.channels; ++c)
                for (std::size_t i = 0; i < pixels; ++i) {
                    const std::size_t channel =
                        std::size_t(image) * tensor_.channels + before_ + std::size_t(c);
                    visit(channel * pixels + i, shape_.index(image, c, 0, 0) + i);
                }
    }
};

/// Returns the largest error divided by the largest expected value, so that a single
/// wrong element is detected. Returns infinity if a value is NaN.
inline double compute_worst_error(const std::vector<double>& actual, const std::vector<double>& expected) {
    if (actual.size() != expected.size()) return HUGE_VAL;
    double worst = 0.0, largest = 0.0;
    for (std::size_t i = 0; i < actual.size(); ++i) {
        if (!std::isfinite(actual[i])) return HUGE_VAL;
        worst = std::max(worst, std::abs(actual[i] - expected[i]));
        largest = std::max(largest, std::abs(expected[i]));
    }
    return largest > 0.0 ? worst / largest : worst;
}
inline double compute_worst_error(const ImageBatch& actual, const ImageBatch& expected) {
    return compute_worst_error(actual.values, expected.values);
}

/// Sets derivatives to 0 if the normalised value is so close to 0 that rounding decides
/// whether ReLU passes the gradient.
inline void exclude_kinks(ImageBatch& upstream, const ImageBatch& from, const std::vector<double>& beta,
                          const std::vector<double>& gamma) {
    reference::NormLayer above{beta, gamma, {}}, below = above;
    for (double& x : below.beta) x = -x;
    for (double& x : below.gamma) x = -x;
    const reference::Moments moments = reference::compute_moments(from);
    const ImageBatch positive = reference::normalise(from, moments, above),
                     negative = reference::normalise(from, moments, below);
    for (std::size_t i = 0; i < upstream.values.size(); ++i)
        if (positive.values[i] + negative.values[i] < 1e-5) upstream.values[i] = 0.0;
}

/// Tolerance of a layer: sums of some hundred products in single precision.
inline constexpr double kLayer = 1e-5;

}  // namespace relidar::test
