// SPDX-License-Identifier: Apache-2.0
#include "diff/network/drop_loss.hpp"

#include <algorithm>

namespace relidar::network {

void RayDropLoss::record_loss(Stream& s, std::size_t n, const RayDropLossArrays& a, std::size_t n_known) {
    // One subgroup processes one part.
    const std::uint32_t of_workgroup = kThreads / lanes_;
    relidar::run(s, kernel_, std::size_t((n_parts_ + of_workgroup - 1) / of_workgroup) * kThreads,
                 {.logit = a.logit,
                  .start = a.start,
                  .target = a.target,
                  .d_logit = a.d_logit,
                  .probability = a.probability,
                  .partial = partial_.address(),
                  .n = std::uint32_t(n),
                  .n_parts = n_parts_,
                  .weight = 1.0f / float(std::max<std::size_t>(n_known, 1))});
}

RayDropScore RayDropLoss::read_loss(std::size_t n_known_pixels) const {
    RayDropScore score;
    const std::vector<float> partial = partial_.download();
    // Each part has two sums: cross-entropies, and number of correct predictions.
    for (std::size_t part = 0; part < n_parts_; ++part) {
        score.entropy += double(partial[2 * part]);
        score.accuracy += double(partial[2 * part + 1]);
    }
    score.entropy /= double(std::max<std::size_t>(n_known_pixels, 1));
    score.accuracy /= double(std::max<std::size_t>(n_known_pixels, 1));
    return score;
}

}  // namespace relidar::network
