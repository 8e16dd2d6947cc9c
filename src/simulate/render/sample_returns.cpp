// SPDX-License-Identifier: Apache-2.0
// Converts the expected values of a scan to random measurements: draws drops, ranges and
// intensities.
#include <bit>

#include <relidar/simulate/render.hpp>

#include "base/geometry/incidence.hpp"
#include "base/parallel.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

// Makes the random numbers of intensities independent of those of drops and ranges.
constexpr std::uint64_t kOfIntensities = 0x696E74656E736974ull;

}  // namespace

RenderedIntensityImage make_noise_image(const RenderedScan& scan) {
    const RangeImage& image = scan.image;
    const bool is_circular = is_full_turn(image.rows, image.columns, image.direction);
    const RangeImageRays rays{.rows = image.rows,
                              .columns = image.columns,
                              .origin = image.origin,
                              .direction = image.direction,
                              .range_m = scan.median_range_m,
                              .circular = is_circular};
    RenderedIntensityImage result{.rows = image.rows,
                                  .columns = image.columns,
                                  .intensity = image.intensity,
                                  .range_m = scan.median_range_m,
                                  .spread_m = range_spread(scan),
                                  .cosine = std::vector<float>(image.direction.size()),
                                  .elevation_rad = std::vector<float>(image.direction.size()),
                                  .circular = is_circular};
    parallel_blocks(image.direction.size(), [&](std::size_t index) {
        result.cosine[index] = static_cast<float>(incidence_cosine(rays, index));
        result.elevation_rad[index] = std::asin(std::clamp(image.direction[index].z, -1.0f, 1.0f));
    });
    return result;
}

void sample_returns(RenderedScan& scan, const RangeNoiseTable& noise, const IntensityScatterModel& scatter,
                    std::uint64_t seed, const RangeLimits& limits) {
    // Each ray has its own generator, so the number of threads does not matter.
    const std::uint64_t of_scan = hash_pair(seed, std::bit_cast<std::uint64_t>(scan.time_s));
    const RenderedIntensityImage likely = make_noise_image(scan);
    const std::vector<float>& likely_m = likely.range_m;
    std::vector<float> ranges_m = likely_m;
    std::vector<std::uint8_t> returning(likely_m.size());
    parallel_blocks(ranges_m.size(), [&](std::size_t i) {
        Random random(hash_pair(of_scan, i));
        bool returns = likely_m[i] > 0.0f && random.sample_uniform() >= double(scan.image.drop_prob[i]);
        // A negative cosine is unknown, and counts as perpendicular incidence.
        const double cosine = double(likely.cosine[i]),
                     sigma_m = noise.lookup_sigma_m(double(likely_m[i]), cosine < 0.0 ? 1.0 : cosine);
        // At least 1 mm, because 0 means no return.
        for (AdditionalReturns& echo : scan.second_returns)
            if (returns && echo.range_m[i] > 0.0f)
                echo.range_m[i] = std::max(
                    echo.range_m[i] + static_cast<float>(noise.lookup_sigma_m(double(echo.range_m[i]), 1.0) *
                                                         random.sample_normal()),
                    1e-3f);
        const float noisy_m =
            returns ? std::max(likely_m[i] + static_cast<float>(sigma_m * random.sample_normal()), 1e-3f)
                    : 0.0f;
        // Noise can move a return out of the sensor's limits. It is then lost.
        returns = returns && limits.contains(double(noisy_m));
        if (returns) ranges_m[i] = noisy_m;
        returning[i] = returns;
        scan.image.drop_prob[i] = returns ? 0.0f : 1.0f;
        for (AdditionalReturns& echo : scan.second_returns)
            if (!returns || !limits.contains(double(echo.range_m[i])))
                echo.range_m[i] = echo.intensity[i] = 0.0f;
    });
    if (!scatter.empty()) {
        const std::vector<float> drawn =
            draw_intensities(scatter, likely, returning, hash_pair(of_scan, kOfIntensities));
        for (std::size_t i = 0; i < drawn.size(); ++i)
            if (returning[i] != 0) scan.image.intensity[i] = drawn[i];
    }
    // Adds the same noise to the mean range as to the median range.
    for (std::size_t i = 0; i < ranges_m.size(); ++i) scan.mean_range_m[i] += ranges_m[i] - likely_m[i];
    scan.image.range_m = ranges_m;
    scan.median_range_m = std::move(ranges_m);
}

}  // namespace relidar
