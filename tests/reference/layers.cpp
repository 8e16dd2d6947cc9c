// SPDX-License-Identifier: Apache-2.0
#include "layers.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::reference {
namespace {

int ring(int index, int size) { return ((index % size) + size) % size; }

/// Calls visit(image, out, in, row, column, tap, source row, source column) for each
/// product of a convolution. Here `tap` is the index of the kernel element.
template <class Visit>
void for_each_product(const ImageBatch& to, int n_in, int taps, Visit&& visit) {
    const int reach = taps == 1 ? 0 : 1, side = 2 * reach + 1;
    for (int image = 0; image < to.n; ++image)
        for (int o = 0; o < to.channels; ++o)
            for (int i = 0; i < n_in; ++i)
                for (int y = 0; y < to.rows; ++y)
                    for (int tap = 0; tap < taps; ++tap) {
                        const int source_y = y + tap / side - reach;
                        if (source_y < 0 || source_y >= to.rows) continue;
                        for (int x = 0; x < to.columns; ++x) {
                            const int source_x = x + tap % side - reach;
                            if (to.circular || (source_x >= 0 && source_x < to.columns))
                                visit(image, o, i, y, x, tap, source_y, ring(source_x, to.columns));
                        }
                    }
}

std::size_t weight_index(int o, int index, int tap, int n_in, int taps) {
    return (std::size_t(o) * n_in + index) * taps + tap;
}

template <class Visit>
void for_values(const ImageBatch& images, Visit&& visit) {
    for (int image = 0; image < images.n; ++image)
        for (int c = 0; c < images.channels; ++c)
            for (std::size_t i = 0; i < images.pixels(); ++i) visit(c, images.index(image, c, 0, 0) + i);
}

/// Returns the interpolation weights of the n_small source entries for entry `position`
/// of n_large entries.
std::vector<double> compute_mixing_weights(int position, int n_large, int n_small, bool circular) {
    const double source_position = (position + 0.5) * n_small / n_large - 0.5,
                 left = std::floor(source_position), share = source_position - left;
    const auto entry = [&](int k) {
        return std::size_t(circular ? ring(k, n_small) : std::clamp(k, 0, n_small - 1));
    };
    std::vector<double> weights(std::size_t(n_small), 0.0);
    weights[entry(int(left))] += 1.0 - share;
    weights[entry(int(left) + 1)] += share;
    return weights;
}

/// Calls visit(large row, large column, small row, small column, weight) for each nonzero
/// weight.
template <class Visit>
void for_mixed(const ImageBatch& large, const ImageBatch& small, Visit&& visit) {
    const int rows = large.rows, columns = large.columns, small_rows = small.rows,
              small_columns = small.columns;
    std::vector<std::vector<double>> of_row, of_column;
    for (int y = 0; y < rows; ++y) of_row.push_back(compute_mixing_weights(y, rows, small_rows, false));
    for (int x = 0; x < columns; ++x)
        of_column.push_back(compute_mixing_weights(x, columns, small_columns, large.circular));
    for (int y = 0; y < rows; ++y)
        for (int v = 0; v < small_rows; ++v) {
            if (of_row[std::size_t(y)][std::size_t(v)] == 0.0) continue;
            for (int x = 0; x < columns; ++x)
                for (int u = 0; u < small_columns; ++u) {
                    const double weight =
                        of_row[std::size_t(y)][std::size_t(v)] * of_column[std::size_t(x)][std::size_t(u)];
                    if (weight != 0.0) visit(y, x, v, u, weight);
                }
        }
}

struct Head {
    int image, query, key, value, to, size;  ///< first channels

    Head(int at, int channels, int heads, int image_at)
        : image(image_at),
          query(at * (channels / heads)),
          key(channels + query),
          value(2 * channels + query),
          to(query),
          size(channels / heads) {}
    double scale() const { return 1.0 / std::sqrt(double(size)); }
    static double get(const ImageBatch& images, int image, int channel, std::size_t pixel) {
        return images.values[images.index(image, channel, 0, 0) + pixel];
    }
    std::vector<double> shares(const ImageBatch& qkv, std::size_t taker) const {
        std::vector<double> p(qkv.pixels());
        for (std::size_t giver = 0; giver < p.size(); ++giver) {
            double score = 0.0;
            for (int c = 0; c < size; ++c)
                score += get(qkv, image, query + c, taker) * get(qkv, image, key + c, giver);
            p[giver] = score * scale();
        }
        const double largest = *std::max_element(p.begin(), p.end());
        double sum = 0.0;
        for (double& x : p) sum += x = std::exp(x - largest);
        for (double& x : p) x /= sum;
        return p;
    }
};

}  // namespace

ImageBatch convolve(const ImageBatch& from, const std::vector<double>& weights,
                    const std::vector<double>& bias, int n_out, int taps) {
    ImageBatch to(from.n, n_out, from.rows, from.columns, from.circular);
    if (!bias.empty())
        for_values(to, [&](int c, std::size_t index) { to.values[index] = bias[std::size_t(c)]; });
    for_each_product(to, from.channels, taps,
                     [&](int image, int o, int index, int y, int x, int tap, int source_y, int source_x) {
                         to.at(image, o, y, x) += weights[weight_index(o, index, tap, from.channels, taps)] *
                                                  from.at(image, index, source_y, source_x);
                     });
    return to;
}

ImageBatch conv_input_vjp(const ImageBatch& d_to, const std::vector<double>& weights, int n_in, int taps) {
    ImageBatch d_from(d_to.n, n_in, d_to.rows, d_to.columns, d_to.circular);
    for_each_product(d_to, n_in, taps,
                     [&](int image, int o, int index, int y, int x, int tap, int source_y, int source_x) {
                         d_from.at(image, index, source_y, source_x) +=
                             weights[weight_index(o, index, tap, n_in, taps)] * d_to.at(image, o, y, x);
                     });
    return d_from;
}

std::vector<double> conv_weights_vjp(const ImageBatch& from, const ImageBatch& d_to, int taps) {
    std::vector<double> d(std::size_t(d_to.channels) * from.channels * taps, 0.0);
    for_each_product(d_to, from.channels, taps,
                     [&](int image, int o, int index, int y, int x, int tap, int source_y, int source_x) {
                         d[weight_index(o, index, tap, from.channels, taps)] +=
                             d_to.at(image, o, y, x) * from.at(image, index, source_y, source_x);
                     });
    return d;
}

std::vector<double> compute_channel_sums(const ImageBatch& d_to) {
    std::vector<double> sums(std::size_t(d_to.channels), 0.0);
    for_values(d_to, [&](int c, std::size_t index) { sums[std::size_t(c)] += d_to.values[index]; });
    return sums;
}

Moments compute_moments(const ImageBatch& from) {
    const double n = double(from.n) * double(from.pixels());
    Moments moments{compute_channel_sums(from), std::vector<double>(std::size_t(from.channels), 0.0)};
    for (double& x : moments.mean) x /= n;
    for_values(from, [&](int c, std::size_t index) {
        const double off = from.values[index] - moments.mean[std::size_t(c)];
        moments.variance[std::size_t(c)] += off * off / n;
    });
    return moments;
}

ImageBatch normalise(const ImageBatch& from, const Moments& moments, const NormLayer& layer) {
    ImageBatch to = from;
    for_values(from, [&](int channel, std::size_t index) {
        const auto c = std::size_t(channel);
        const double x =
            (from.values[index] - moments.mean[c]) / std::sqrt(moments.variance[c] + layer.epsilon);
        to.values[index] = std::max(layer.gamma[c] * x + layer.beta[c], 0.0) *
                           (layer.gate.empty() ? 1.0 : layer.gate[index]);
    });
    return to;
}

NormGradient backpropagate_normalisation(const ImageBatch& from, const NormLayer& layer,
                                         const ImageBatch& d_to) {
    const Moments moments = compute_moments(from);
    const double n = double(from.n) * double(from.pixels());
    const std::vector<double> zeros(layer.beta.size(), 0.0);
    NormGradient d{from, zeros, zeros};
    std::vector<double> x = from.values, d_x = from.values, d_mean = zeros, d_variance = zeros;
    for_values(from, [&](int channel, std::size_t index) {
        const auto c = std::size_t(channel);
        const double deviation = std::sqrt(moments.variance[c] + layer.epsilon);
        x[index] = (from.values[index] - moments.mean[c]) / deviation;
        const bool on = layer.gamma[c] * x[index] + layer.beta[c] > 0.0;
        const double gate = layer.gate.empty() ? 1.0 : layer.gate[index];
        const double g = on ? d_to.values[index] * gate : 0.0;
        d.beta[c] += g;
        d.gamma[c] += g * x[index];
        d_x[index] = g * layer.gamma[c];
        d_mean[c] -= d_x[index] / deviation;
        d_variance[c] -= 0.5 * d_x[index] * x[index] / (deviation * deviation);
    });
    for_values(from, [&](int channel, std::size_t index) {
        const auto c = std::size_t(channel);
        d.from.values[index] = d_x[index] / std::sqrt(moments.variance[c] + layer.epsilon) + d_mean[c] / n +
                               d_variance[c] * 2.0 * (from.values[index] - moments.mean[c]) / n;
    });
    return d;
}

ImageBatch pool(const ImageBatch& from) {
    ImageBatch to(from.n, from.channels, from.rows / 2, from.columns / 2, from.circular);
    to.for_each([&](int image, int c, int y, int x) {
        to.at(image, c, y, x) =
            std::max({from.at(image, c, 2 * y, 2 * x), from.at(image, c, 2 * y, 2 * x + 1),
                      from.at(image, c, 2 * y + 1, 2 * x), from.at(image, c, 2 * y + 1, 2 * x + 1)});
    });
    return to;
}

ImageBatch backpropagate_pool(const ImageBatch& from, const ImageBatch& d_to) {
    const ImageBatch largest = pool(from);
    ImageBatch d_from(from.n, from.channels, from.rows, from.columns);
    d_to.for_each([&](int image, int c, int y, int x) {
        for (int k = 0; k < 4; ++k) {
            if (from.at(image, c, 2 * y + k / 2, 2 * x + k % 2) != largest.at(image, c, y, x)) continue;
            d_from.at(image, c, 2 * y + k / 2, 2 * x + k % 2) += d_to.at(image, c, y, x);
            break;
        }
    });
    return d_from;
}

ImageBatch upsample(const ImageBatch& from, int rows, int columns) {
    ImageBatch to(from.n, from.channels, rows, columns, from.circular);
    for_mixed(to, from, [&](int y, int x, int v, int u, double weight) {
        for (int image = 0; image < to.n; ++image)
            for (int c = 0; c < to.channels; ++c) to.at(image, c, y, x) += weight * from.at(image, c, v, u);
    });
    return to;
}

ImageBatch upsample_vjp(const ImageBatch& d_to, int rows, int columns) {
    ImageBatch d_from(d_to.n, d_to.channels, rows, columns, d_to.circular);
    for_mixed(d_to, d_from, [&](int y, int x, int v, int u, double weight) {
        for (int image = 0; image < d_to.n; ++image)
            for (int c = 0; c < d_to.channels; ++c)
                d_from.at(image, c, v, u) += weight * d_to.at(image, c, y, x);
    });
    return d_from;
}

ImageBatch attend(const ImageBatch& qkv, int heads) {
    const int channels = qkv.channels / 3;
    ImageBatch to(qkv.n, channels, qkv.rows, qkv.columns, qkv.circular);
    for (int job = 0; job < qkv.n * heads; ++job) {
        const Head head(job % heads, channels, heads, job / heads);
        for (std::size_t taker = 0; taker < qkv.pixels(); ++taker) {
            const std::vector<double> shares = head.shares(qkv, taker);
            for (int c = 0; c < head.size; ++c)
                for (std::size_t giver = 0; giver < qkv.pixels(); ++giver)
                    to.values[to.index(head.image, head.to + c, 0, 0) + taker] +=
                        shares[giver] * Head::get(qkv, head.image, head.value + c, giver);
        }
    }
    return to;
}

ImageBatch attention_vjp(const ImageBatch& qkv, int heads, const ImageBatch& d_to) {
    const int channels = qkv.channels / 3;
    ImageBatch d(qkv.n, qkv.channels, qkv.rows, qkv.columns);
    const auto add = [&](int image, int channel, std::size_t pixel, double value) {
        d.values[d.index(image, channel, 0, 0) + pixel] += value;
    };
    for (int job = 0; job < qkv.n * heads; ++job) {
        const Head head(job % heads, channels, heads, job / heads);
        for (std::size_t taker = 0; taker < qkv.pixels(); ++taker) {
            const std::vector<double> shares = head.shares(qkv, taker);
            std::vector<double> d_share(shares.size(), 0.0);
            double mean = 0.0;
            for (std::size_t giver = 0; giver < shares.size(); ++giver) {
                for (int c = 0; c < head.size; ++c) {
                    const double d_output = Head::get(d_to, head.image, head.to + c, taker);
                    d_share[giver] += d_output * Head::get(qkv, head.image, head.value + c, giver);
                    add(head.image, head.value + c, giver, shares[giver] * d_output);
                }
                mean += shares[giver] * d_share[giver];
            }
            for (std::size_t giver = 0; giver < shares.size(); ++giver) {
                const double d_score = shares[giver] * (d_share[giver] - mean) * head.scale();
                for (int c = 0; c < head.size; ++c) {
                    add(head.image, head.query + c, taker,
                        d_score * Head::get(qkv, head.image, head.key + c, giver));
                    add(head.image, head.key + c, giver,
                        d_score * Head::get(qkv, head.image, head.query + c, taker));
                }
            }
        }
    }
    return d;
}

DropEntropy compute_drop_entropy(const std::vector<double>& logit, const std::vector<double>& target) {
    DropEntropy result;
    const double n_known_targets =
        double(std::count_if(target.begin(), target.end(), [](double t) { return t >= 0.0; }));
    for (std::size_t i = 0; i < logit.size(); ++i) {
        const double p = 1.0 / (1.0 + std::exp(-logit[i]));
        result.probability.push_back(p);
        result.d_logit.push_back(target[i] >= 0.0 ? (p - target[i]) / n_known_targets : 0.0);
        if (target[i] < 0.0) continue;
        // -log p = log(1 + exp(-x)), in the form that does not overflow for the sign of x
        const double log_p =
            logit[i] < 0.0 ? logit[i] - std::log1p(std::exp(logit[i])) : -std::log1p(std::exp(-logit[i]));
        result.mean -= (target[i] * log_p + (1.0 - target[i]) * (log_p - logit[i])) / n_known_targets;
        result.accuracy += ((p > 0.5) == (target[i] > 0.5) ? 1.0 : 0.0) / n_known_targets;
    }
    return result;
}

}  // namespace relidar::reference
