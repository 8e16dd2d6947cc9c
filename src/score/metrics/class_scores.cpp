// SPDX-License-Identifier: Apache-2.0
#include <relidar/score/metrics.hpp>

#include <array>

namespace relidar {

/// Computes the accuracy and the mean intersection over union of the classes that occur.
MetricValues score_classes(const std::vector<std::int32_t>& rendered, std::span<const SurfaceClass> real) {
    std::array<double, kSurfaceClasses> n_both{}, n_either{}, n_real{};
    double n = 0.0, n_equal = 0.0;
    for (std::size_t i = 0; i < real.size(); ++i) {
        if (real[i] == SurfaceClass::unknown) continue;
        const auto label = std::size_t(real[i]);
        n += 1.0;
        n_real[label] += 1.0;
        n_either[label] += 1.0;
        if (rendered[i] == std::int32_t(label)) {
            n_equal += 1.0;
            n_both[label] += 1.0;
        } else if (rendered[i] >= 0) n_either[std::size_t(rendered[i])] += 1.0;
    }
    if (n == 0.0) return {};
    double sum = 0.0, n_classes = 0.0;
    for (std::size_t k = 0; k < kSurfaceClasses; ++k)
        if (n_real[k] > 0.0) {
            sum += n_both[k] / n_either[k];
            n_classes += 1.0;
        }
    return {{"classes/accuracy", n_equal / n}, {"classes/mean_iou", sum / n_classes}};
}

}  // namespace relidar
