// SPDX-License-Identifier: Apache-2.0
#include "log/frames/match_sweeps.hpp"

#include <algorithm>
#include <cmath>

#include "base/median.hpp"

namespace relidar {

double median_interval_s(std::vector<double> sweep_times_s) {
    if (sweep_times_s.size() < 2) return 0.1;
    std::ranges::sort(sweep_times_s);
    std::vector<double> steps;
    for (std::size_t i = 1; i < sweep_times_s.size(); ++i)
        steps.push_back(sweep_times_s[i] - sweep_times_s[i - 1]);
    const double step_s = compute_median(std::move(steps));
    return step_s > 1e-3 ? step_s : 0.1;
}

std::vector<std::optional<std::size_t>> match_sweeps(const std::vector<double>& main_times_s,
                                                     const std::vector<double>& other_times_s,
                                                     double max_difference_s) {
    // If the LiDARs sweep half a period apart, each sweep has two nearest sweeps. All use
    // the earlier one, so that rounding does not change the choice.
    constexpr double kTieShare = 0.05;  // in units of max_difference_s
    const auto distance_s = [&](std::size_t main_sweep, std::size_t other_sweep) {
        return std::abs(other_times_s[other_sweep] - main_times_s[main_sweep]);
    };
    std::vector<std::optional<std::size_t>> matches(main_times_s.size());
    for (std::size_t other_sweep = 0; other_sweep < other_times_s.size(); ++other_sweep) {
        const auto after = std::ranges::lower_bound(main_times_s, other_times_s[other_sweep]);
        std::size_t main_sweep = std::min(std::size_t(after - main_times_s.begin()), main_times_s.size() - 1);
        const double tie_s = kTieShare * max_difference_s;
        if (main_sweep > 0 &&
            distance_s(main_sweep - 1, other_sweep) < distance_s(main_sweep, other_sweep) + tie_s)
            --main_sweep;
        if (distance_s(main_sweep, other_sweep) > max_difference_s) continue;
        // Of several sweeps with the same main sweep, keeps the nearest.
        const bool is_nearest = !matches[main_sweep] || distance_s(main_sweep, other_sweep) <
                                                            distance_s(main_sweep, *matches[main_sweep]);
        if (is_nearest) matches[main_sweep] = other_sweep;
    }
    return matches;
}

}  // namespace relidar
