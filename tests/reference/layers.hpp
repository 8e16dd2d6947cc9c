// SPDX-License-Identifier: Apache-2.0
// Layers of the ray-drop network written out in double: images [n, channels, rows,
// columns], columns a ring, beyond the rows zeros.
#pragma once

#include <cstddef>
#include <vector>

namespace relidar::reference {

struct ImageBatch {
    int n = 0, channels = 0, rows = 0, columns = 0;
    std::vector<double> values;  ///< [n,channels,rows,columns]

    ImageBatch() = default;
    ImageBatch(int n_images, int n_channels, int n_rows, int n_columns)
        : n(n_images),
          channels(n_channels),
          rows(n_rows),
          columns(n_columns),
          values(std::size_t(n) * channels * rows * columns, 0.0) {}
    std::size_t index(int image, int channel, int row, int column) const {
        return ((std::size_t(image) * channels + channel) * rows + row) * columns + column;
    }
    double& at(int image, int channel, int row, int column) {
        return values[index(image, channel, row, column)];
    }
    double at(int image, int channel, int row, int column) const {
        return values[index(image, channel, row, column)];
    }
    std::size_t pixels() const { return std::size_t(rows) * columns; }
};

/// @param weights  [n_out, from.channels, taps], taps 1 or 9 @param bias  [n_out], or
/// empty
ImageBatch convolve(const ImageBatch& from, const std::vector<double>& weights,
                    const std::vector<double>& bias, int n_out, int taps);
ImageBatch convolve_input_vjp(const ImageBatch& d_to, const std::vector<double>& weights, int n_in, int taps);
/// @return [d_to.channels, from.channels, taps]
std::vector<double> convolve_weights_vjp(const ImageBatch& from, const ImageBatch& d_to, int taps);
/// Of each channel over all images: derivative by a bias.
std::vector<double> channel_sums(const ImageBatch& d_to);

struct Moments {
    std::vector<double> mean, variance;  ///< [channels], of the whole batch (divided by its size)
};
Moments moments_of(const ImageBatch& from);

struct NormLayer {
    std::vector<double> beta, gamma;  ///< [channels]
    std::vector<double> gate;         ///< [n,channels,rows,columns] factor behind ReLU (dropout), or empty
    double epsilon = 1e-5;
};
/// gate * relu(gamma (from - mean) / sqrt(variance + epsilon) + beta)
ImageBatch normalise(const ImageBatch& from, const Moments& moments, const NormLayer& layer);
struct NormGradient {
    ImageBatch from;
    std::vector<double> beta, gamma;  ///< [channels]
};
/// Of normalise() by the moments of `from` itself, which depend on it.
NormGradient normalise_vjp(const ImageBatch& from, const NormLayer& layer, const ImageBatch& d_to);

/// Largest of 2 x 2; what is left of odd sizes is not looked at.
ImageBatch pool(const ImageBatch& from);
/// To the first of the largest, row by row.
ImageBatch pool_vjp(const ImageBatch& from, const ImageBatch& d_to);
/// Bilinear, pixel centres at half steps; rows end with the last one, columns are a ring.
ImageBatch upsample(const ImageBatch& from, int rows, int columns);
ImageBatch upsample_vjp(const ImageBatch& d_to, int rows, int columns);

/// Query, key and value of each pixel one behind the other in the channels, heads within
/// each.
ImageBatch attend(const ImageBatch& qkv, int heads);
ImageBatch attend_vjp(const ImageBatch& qkv, int heads, const ImageBatch& d_to);

struct DropEntropy {
    double mean = 0.0, accuracy = 0.0;         ///< over known pixels; 0 where there are none
    std::vector<double> probability, d_logit;  ///< of each pixel; derivative of the mean
};
/// @param target  1 dropped, 0 returned, negative: not known
DropEntropy drop_entropy(const std::vector<double>& logit, const std::vector<double>& target);

}  // namespace relidar::reference
