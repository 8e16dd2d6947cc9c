// SPDX-License-Identifier: Apache-2.0
#include "surfel_loss.hpp"

#include <cmath>
#include <cstddef>

namespace relidar::reference {

double compute_box_loss(const BoxedSurfel& surfel, const Box& box, double scale, BoxedSurfel& gradient) {
    double loss = 0.0;
    for (std::size_t a = 0; a < 3; ++a)
        if (std::abs(surfel.mean[a]) > box.half_size_m[a]) {
            loss += std::abs(surfel.mean[a]) / box.half_size_m[a] - 1.0;
            gradient.mean[a] += scale * (surfel.mean[a] > 0.0 ? 1.0 : -1.0) / box.half_size_m[a];
        }
    const auto add_scale = [&](double log_scale) {
        const double relative = std::exp(log_scale) / box.largest_scale_m;
        if (relative <= 1.0) return 0.0;
        loss += relative - 1.0;
        return scale * relative;
    };
    for (std::size_t a = 0; a < 2; ++a) gradient.log_scale[a] += add_scale(surfel.log_scale[a]);
    if (surfel.log_scale_w)
        gradient.log_scale_w = gradient.log_scale_w.value_or(0.0) + add_scale(*surfel.log_scale_w);
    return loss;
}

}  // namespace relidar::reference
