// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/match_sweeps.hpp"

#include <algorithm>
#include <cmath>

#include "base/median.hpp"

namespace relidar {

double compute_median_step_s(std::vector<double> times_s) {
    if (times_s.size() < 2) return 0.1;
    std::ranges::sort(times_s);
    std::vector<double> steps;
    for (std::size_t i = 1; i < times_s.size(); ++i) steps.push_back(times_s[i] - times_s[i - 1]);
    const double step_s = compute_median(std::move(steps));
    return step_s > 1e-3 ? step_s : 0.1;
}

std::vector<std::optional<std::size_t>> match_sweeps(const std::vector<double>& main_s,
                                                     const std::vector<double>& other_s,
                                                     double max_difference_s) {
    std::vector<std::optional<std::size_t>> beside(main_s.size());
    for (std::size_t i = 0; i < other_s.size(); ++i) {
        const auto distance_s = [&](std::size_t index, std::size_t other) {
            return std::abs(other_s[other] - main_s[index]);
        };
        const auto after = std::ranges::lower_bound(main_s, other_s[i]);
        std::size_t k = std::min(std::size_t(after - main_s.begin()), main_s.size() - 1);
        if (k > 0 && distance_s(k - 1, i) < distance_s(k, i)) --k;
        if (distance_s(k, i) <= max_difference_s &&
            (!beside[k] || distance_s(k, i) < distance_s(k, *beside[k])))
            beside[k] = i;
    }
    return beside;
}

}  // namespace relidar
