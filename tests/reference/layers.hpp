// SPDX-License-Identifier: Apache-2.0
// Implements the layers of the ray-drop network in double. Images are [n, channels, rows,
// columns]. Rows are padded with zeros. Columns wrap around in circular images, otherwise
// they are padded, too.
#pragma once

#include <cstddef>
#include <vector>

namespace relidar::reference {

struct ImageBatch {
    int n = 0, channels = 0, rows = 0, columns = 0;
    bool circular = true;
    std::vector<double> values;  ///< [n,channels,rows,columns]

    ImageBatch() = default;
    ImageBatch(int n_images, int n_channels, int n_rows, int n_columns, bool is_circular = true)
        : n(n_images),
          channels(n_channels),
          rows(n_rows),
          columns(n_columns),
          circular(is_circular),
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
    /// Calls visit(image, channel, row, column) for each value.
    template <class Visit>
    void for_each(Visit&& visit) const {
        for (int image = 0; image < n; ++image)
            for (int c = 0; c < channels; ++c)
                for (int y = 0; y < rows; ++y)
                    for (int x = 0; x < columns; ++x) visit(image, c, y, x);
    }
};

/// Returns the convolution of a batch.
/// @param weights [n_out, from.channels, taps], where the number of kernel elements
/// (taps) is 1 or 9
/// @param bias [n_out], or empty
ImageBatch convolve(const ImageBatch& from, const std::vector<double>& weights,
                    const std::vector<double>& bias, int n_out, int taps);
ImageBatch conv_input_vjp(const ImageBatch& d_to, const std::vector<double>& weights, int n_in, int taps);
/// Returns the derivative of a convolution with respect to its weights.
/// @return [d_to.channels, from.channels, number of kernel elements]
std::vector<double> conv_weights_vjp(const ImageBatch& from, const ImageBatch& d_to, int taps);
/// Returns the sum of each channel over all images, which is the derivative with respect
/// to a bias.
std::vector<double> compute_channel_sums(const ImageBatch& d_to);

struct Moments {
    /// [channels] mean and variance over the full batch. The variance is the sum of
    /// squares divided by the batch size.
    std::vector<double> mean, variance;
};
Moments compute_moments(const ImageBatch& from);

struct NormLayer {
    std::vector<double> beta, gamma;  ///< [channels]
    /// [n,channels,rows,columns] dropout factor that is applied after ReLU, or empty
    std::vector<double> gate;
    double epsilon = 1e-5;
};
/// Returns gate * relu(gamma (from - mean) / sqrt(variance + epsilon) + beta).
ImageBatch normalise(const ImageBatch& from, const Moments& moments, const NormLayer& layer);
struct NormGradient {
    ImageBatch from;
    std::vector<double> beta, gamma;  ///< [channels]
};
/// Returns the derivatives of normalise(). Mean and variance depend on `from`, so the
/// derivatives include this dependence.
NormGradient backpropagate_normalisation(const ImageBatch& from, const NormLayer& layer,
                                         const ImageBatch& d_to);

/// Returns the maximum of each 2 x 2 block. Ignores the last row or column of odd sizes.
ImageBatch pool(const ImageBatch& from);
/// Adds the derivative of each block to the first pixel that has the maximum, in row
/// order.
ImageBatch backpropagate_pool(const ImageBatch& from, const ImageBatch& d_to);
/// Resizes images bilinearly, with pixel centres at half steps. Rows are clamped at the
/// border, and so are columns of images that are not circular.
ImageBatch upsample(const ImageBatch& from, int rows, int columns);
ImageBatch upsample_vjp(const ImageBatch& d_to, int rows, int columns);

/// Applies attention. The channels of a pixel are the query, the key and the value.
/// Within each of these, the channels of a head are contiguous.
ImageBatch attend(const ImageBatch& qkv, int heads);
ImageBatch attention_vjp(const ImageBatch& qkv, int heads, const ImageBatch& d_to);

struct DropEntropy {
    /// Loss and accuracy over pixels with a target. Both are 0 if no pixel has a target.
    double mean = 0.0, accuracy = 0.0;
    /// drop probability of each pixel, and derivative of the mean
    std::vector<double> probability, d_logit;
};
/// Computes the cross-entropy of ray drops.
/// @param target 1 means dropped, 0 means returned. A negative value means unknown.
DropEntropy compute_drop_entropy(const std::vector<double>& logit, const std::vector<double>& target);

}  // namespace relidar::reference
