// SPDX-License-Identifier: Apache-2.0
#include "surfel_loss.hpp"

#include <cmath>
#include <cstddef>

namespace relidar::reference {

double box_loss(const BoxedSurfel& surfel, const Box& box, double scale, BoxedSurfel& d) {
    double loss = 0.0;
    for (std::size_t a = 0; a < 3; ++a)
        if (std::abs(surfel.mean[a]) > box.half_size_m[a]) {
            loss += std::abs(surfel.mean[a]) / box.half_size_m[a] - 1.0;
            d.mean[a] += scale * (surfel.mean[a] > 0.0 ? 1.0 : -1.0) / box.half_size_m[a];
        }
    for (std::size_t a = 0; a < 2; ++a)
        if (std::exp(surfel.log_scale[a]) > box.largest_scale_m) {
            loss += std::exp(surfel.log_scale[a]) / box.largest_scale_m - 1.0;
            d.log_scale[a] += scale * std::exp(surfel.log_scale[a]) / box.largest_scale_m;
        }
    return loss;
}

double opacity_entropy(double logit, double& derivative) {
    const double p = 1.0 / (1.0 + std::exp(-logit)), q = 1.0 / (1.0 + std::exp(logit));
    derivative = -logit * p * q;
    return -(p > 0.0 ? p * std::log(p) : 0.0) - (q > 0.0 ? q * std::log(q) : 0.0);
}

}  // namespace relidar::reference
