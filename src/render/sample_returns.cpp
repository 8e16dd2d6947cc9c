// SPDX-License-Identifier: Apache-2.0
// One scan drawn from the likely ones.
#include <algorithm>
#include <bit>
#include <cmath>

#include <relidar/render.hpp>

#include "core/incidence.hpp"
#include "core/random.hpp"

namespace relidar {

void sample_returns(RenderedScan& scan, const RangeNoise& noise, std::uint64_t seed) {
    const std::uint64_t of_scan = hash64(seed, std::bit_cast<std::uint64_t>(scan.time_s));
    const std::vector<float>& likely_m = scan.median_range_m;
    const ImageRays image{scan.image.rows, scan.image.columns, scan.image.origin, scan.image.direction, likely_m};
    std::vector<float> ranges_m = likely_m;
    for (std::size_t i = 0; i < ranges_m.size(); ++i) {
        Random random(hash64(of_scan, i));
        const bool returns = likely_m[i] > 0.0f && random.uniform() >= double(scan.image.drop_prob[i]);
        scan.image.drop_prob[i] = returns ? 0.0f : 1.0f;
        const double cosine = incidence_cosine(image, i), sigma_m = noise.at(double(likely_m[i]), cosine < 0.0 ? 1.0 : cosine);
        for (SecondReturn& echo : scan.second_returns) {
            if (!returns) echo.range_m[i] = echo.intensity[i] = 0.0f;
            if (echo.range_m[i] > 0.0f)
                echo.range_m[i] =
                    std::max(echo.range_m[i] + static_cast<float>(noise.at(double(echo.range_m[i]), 1.0) * random.normal()), 1e-3f);
        }
        if (returns) ranges_m[i] = std::max(likely_m[i] + static_cast<float>(sigma_m * random.normal()), 1e-3f);
    }
    for (std::size_t i = 0; i < ranges_m.size(); ++i) scan.mean_range_m[i] += ranges_m[i] - likely_m[i];   // noise spreads nothing
    scan.image.range_m = ranges_m;
    scan.median_range_m = std::move(ranges_m);
}

}  // namespace relidar
