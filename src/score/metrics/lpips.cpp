// SPDX-License-Identifier: Apache-2.0
// Computes LPIPS (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a
// Perceptual Metric", CVPR 2018) with AlexNet features. Computes each of the five
// convolutions as a matrix product of unrolled windows (columns) and filters (rows). Runs
// on the CPU, which is fast enough. Reads the weights from a file, because they are not
// part of the program.
#include <relidar/score/metrics.hpp>

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Core>

#include "base/fail.hpp"

namespace relidar {
namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr int kConvLayers = 5;
// the pooling layers reduce 31 pixels to 7, 3 and finally 1
constexpr int kMinEdgePixels = 31;
// Added to the length of a feature vector, so that a zero vector can be normalised.
constexpr double kNormFloor = 1e-10;
constexpr float kColourShift[3] = {-0.030f, -0.088f, -0.188f};
constexpr float kColourScale[3] = {0.458f, 0.448f, 0.450f};

/// If `pooled`, 3 x 3 max-pooling with stride 2 precedes the convolution.
struct ConvLayerShape {
    int out, in, edge, stride, padding;
    bool pooled;
};
constexpr ConvLayerShape kAlexNet[kConvLayers] = {{64, 3, 11, 4, 2, false},
                                                  {192, 64, 5, 1, 2, true},
                                                  {384, 192, 3, 1, 1, true},
                                                  {256, 384, 3, 1, 1, false},
                                                  {256, 256, 3, 1, 1, false}};

/// one image of rows x columns pixels for each channel
struct FeatureMap {
    int rows = 0, columns = 0;
    Matrix values;  ///< [channels, rows*columns]
};

/// Copies the window around each output pixel into a column of a matrix (im2col), so that
/// a convolution is a matrix product. Pixels outside of the image are 0.
/// @return [in*edge*edge, output_rows*output_columns]
Matrix im2col(const FeatureMap& input, const ConvLayerShape& layer, int output_rows, int output_columns) {
    Matrix windows = Matrix::Zero(Eigen::Index(layer.in) * layer.edge * layer.edge,
                                  Eigen::Index(output_rows) * output_columns);
    for (Eigen::Index k = 0; k < windows.rows(); ++k) {
        // Row k: the same pixel of all windows (a channel, an offset from the centre).
        const float* channel = input.values.row(k / (layer.edge * layer.edge)).data();
        const int row_offset = int(k) / layer.edge % layer.edge - layer.padding;
        const int column_offset = int(k) % layer.edge - layer.padding;
        for (int row = 0; row < output_rows; ++row) {
            const int y = row * layer.stride + row_offset;
            if (y < 0 || y >= input.rows) continue;
            for (int column = 0; column < output_columns; ++column) {
                const int x = column * layer.stride + column_offset;
                if (x >= 0 && x < input.columns)
                    windows(k, Eigen::Index(row) * output_columns + column) = channel[y * input.columns + x];
            }
        }
    }
    return windows;
}

/// Applies a convolution as one matrix product, then adds the bias and applies ReLU.
FeatureMap convolve_relu(const FeatureMap& input_features, const ConvLayerShape& layer,
                         const std::vector<float>& filter_weights, const std::vector<float>& bias) {
    FeatureMap result;
    result.rows = (input_features.rows + 2 * layer.padding - layer.edge) / layer.stride + 1;
    result.columns = (input_features.columns + 2 * layer.padding - layer.edge) / layer.stride + 1;
    const Eigen::Map<const Matrix> filters(filter_weights.data(), layer.out,
                                           Eigen::Index(layer.in) * layer.edge * layer.edge);
    result.values.noalias() = filters * im2col(input_features, layer, result.rows, result.columns);
    result.values.colwise() += Eigen::Map<const Eigen::VectorXf>(bias.data(), layer.out);
    result.values = result.values.cwiseMax(0.0f);
    return result;
}

/// Applies a 3 x 3 max-pooling with stride 2 to feature images.
FeatureMap max_pool(const FeatureMap& input_features) {
    FeatureMap result{(input_features.rows - 3) / 2 + 1, (input_features.columns - 3) / 2 + 1, {}};
    result.values.resize(input_features.values.rows(), Eigen::Index(result.rows) * result.columns);
    for (Eigen::Index channel = 0; channel < input_features.values.rows(); ++channel) {
        const Eigen::Map<const Matrix> in(input_features.values.row(channel).data(), input_features.rows,
                                          input_features.columns);
        for (int row = 0; row < result.rows; ++row)
            for (int column = 0; column < result.columns; ++column)
                result.values(channel, Eigen::Index(row) * result.columns + column) =
                    in.block<3, 3>(2 * row, 2 * column).maxCoeff();
    }
    return result;
}

/// Returns the LPIPS distance of two feature images. At each pixel, normalises both
/// feature vectors to unit length and computes their weighted squared difference.
/// Averages over all pixels.
double feature_distance(const FeatureMap& a, const FeatureMap& b, const std::vector<float>& weights) {
    const Eigen::ArrayXXd fa = a.values.cast<double>().array(), fb = b.values.cast<double>().array();
    const Eigen::ArrayXd weight =
        Eigen::Map<const Eigen::VectorXf>(weights.data(), Eigen::Index(weights.size()))
            .cast<double>()
            .array();
    double sum = 0.0;
    for (Eigen::Index pixel = 0; pixel < fa.cols(); ++pixel) {
        const double length_a = std::sqrt(fa.col(pixel).square().sum()) + kNormFloor;
        const double length_b = std::sqrt(fb.col(pixel).square().sum()) + kNormFloor;
        sum += (weight * (fa.col(pixel) / length_a - fb.col(pixel) / length_b).square()).sum();
    }
    return sum / double(fa.cols());
}

FeatureMap normalise(const std::vector<float>& image, int rows, int columns) {
    FeatureMap result{rows, columns, Eigen::Map<const Matrix>(image.data(), 3, Eigen::Index(rows) * columns)};
    for (int colour = 0; colour < 3; ++colour)
        result.values.row(colour) =
            (result.values.row(colour).array() - kColourShift[colour]) / kColourScale[colour];
    return result;
}

void check_weights(const char* name, int layer, const std::vector<float>& values, std::size_t count) {
    if (values.size() != count || !std::ranges::all_of(values, [](float v) { return std::isfinite(v); }))
        fail("cannot use the weights of LPIPS: found {} values of the {}{}, expected {} finite values",
             values.size(), name, layer, count);
}

}  // namespace

struct Lpips::Impl {
    LpipsWeights weights;
};

Lpips::Lpips(LpipsWeights weights) : impl_(new Impl{std::move(weights)}) {
    for (int l = 0; l < kConvLayers; ++l) {
        const ConvLayerShape& shape = kAlexNet[l];
        const std::size_t k = std::size_t(l), channels = std::size_t(shape.out);
        const std::size_t n_weights =
            channels * std::size_t(shape.in) * std::size_t(shape.edge) * std::size_t(shape.edge);
        check_weights("weight of convolution ", l, impl_->weights.weight[k], n_weights);
        check_weights("bias of convolution ", l, impl_->weights.bias[k], channels);
        check_weights("linear weights of layer ", l, impl_->weights.linear[k], channels);
    }
}
Lpips::~Lpips() = default;

std::array<double, 5> Lpips::layer_distances(const std::vector<float>& first_image,
                                             const std::vector<float>& second_image, int rows,
                                             int columns) const {
    const std::size_t n = 3 * std::size_t(std::max(rows, 0)) * std::size_t(std::max(columns, 0));
    if (rows < kMinEdgePixels || columns < kMinEdgePixels || first_image.size() != n ||
        second_image.size() != n)
        fail(
            "cannot compute LPIPS: found {} x {} pixels and images of {} and {} values, expected at least 31 "
            "x "
            "31 pixels, and 3 values for each",
            rows, columns, first_image.size(), second_image.size());
    FeatureMap first = normalise(first_image, rows, columns), second = normalise(second_image, rows, columns);
    std::array<double, 5> distance{};
    for (std::size_t stage = 0; stage < distance.size(); ++stage) {
        // Both images pass the same layers. Each layer gives one distance.
        const ConvLayerShape& layer = kAlexNet[stage];
        for (FeatureMap* features : {&first, &second})
            *features = convolve_relu(layer.pooled ? max_pool(*features) : *features, layer,
                                      impl_->weights.weight[stage], impl_->weights.bias[stage]);
        distance[stage] = feature_distance(first, second, impl_->weights.linear[stage]);
    }
    return distance;
}

double Lpips::compute_distance(const std::vector<double>& a, const std::vector<double>& b, int rows,
                               int columns) const {
    const auto colours = [](const std::vector<double>& image) {
        std::vector<float> result;
        result.reserve(3 * image.size());
        for (int colour = 0; colour < 3; ++colour)
            for (const double v : image) result.push_back(2.0f * static_cast<float>(v) - 1.0f);
        return result;
    };
    double sum = 0.0;
    for (const double layer : layer_distances(colours(a), colours(b), rows, columns)) sum += layer;
    return sum;
}

}  // namespace relidar
