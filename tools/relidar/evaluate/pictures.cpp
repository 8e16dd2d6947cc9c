// SPDX-License-Identifier: Apache-2.0
#include "evaluate/pictures.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/log/sensor.hpp>
#include <relidar/simulate/scan_files.hpp>
#include "evaluate/evaluation.hpp"

namespace relidar::cli {
namespace {

constexpr float kRangeErrorScale_m = 1.0f;
constexpr float kIntensityErrorScale = 0.3f;

}  // namespace

/// Returns pictures of a real scan, the rendered scan and their difference, for range,
/// intensity and ray drop.
std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title,
                                             const std::string& real_caption, double max_range_m) {
    const RangeImage& real = frame.real;
    const RangeImage& rendered = frame.rendered.image;
    // The mask is 1 for rays that return in both images, because other rays have no range
    // error.
    std::vector<float> mask = return_mask(real);
    const std::vector<float> rendered_mask = return_mask(rendered);
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] *= rendered_mask[i];
    const auto error = [&](const std::vector<float>& first, const std::vector<float>& second, float scale,
                           const std::vector<float>& shown) {
        std::vector<float> differences(first.size());
        for (std::size_t i = 0; i < first.size(); ++i) differences[i] = std::abs(first[i] - second[i]);
        return apply_colour_map(differences, real.rows, real.columns, 0.0f, scale, "heat", shown);
    };
    ReportFigure drops{title + ": ray drop", {{real_caption + ", white: dropped rays", draw_drop(real)}}};
    if (const auto* of_surfels = find_values<float>(frame.rendered.channels, "surfel_drop_prob")) {
        RangeImage surfels = rendered;
        surfels.drop_prob = *of_surfels;
        drops.images.emplace_back("drop probability of the surfels", draw_drop(surfels));
        drops.images.emplace_back("absolute error of the drop probability of the surfels",
                                  error(real.drop_prob, surfels.drop_prob, 1.0f, {}));
        drops.images.emplace_back("rendered drop probability, corrected by the network", draw_drop(rendered));
    } else {
        drops.images.emplace_back("rendered drop probability", draw_drop(rendered));
    }
    drops.images.emplace_back("absolute error of the drop probability, black: 0, white: 1",
                              error(real.drop_prob, rendered.drop_prob, 1.0f, {}));
    std::vector<ReportFigure> figures = {
        {title + ": range",
         {{real_caption, draw_range(real, max_range_m)},
          {"rendered", draw_range(rendered, max_range_m)},
          {fmt::format("absolute error of rays that return in both scans, black: 0, white: {} m",
                       kRangeErrorScale_m),
           error(real.range_m, rendered.range_m, kRangeErrorScale_m, mask)}}}};
    if (has_intensities(real))
        figures.push_back(
            {title + ": intensity",
             {{real_caption, draw_intensity(real)},
              {"rendered", draw_intensity(rendered)},
              {fmt::format("absolute error of rays that return in both scans, black: 0, white: {}",
                           kIntensityErrorScale),
               error(real.intensity, rendered.intensity, kIntensityErrorScale, mask)}}});
    figures.push_back(std::move(drops));
    return figures;
}

void write_comparison(const std::filesystem::path& folder, const ScoredFrame& frame, double max_range_m) {
    std::vector<const char*> names = {"range", "intensity", "drop"};
    // comparison_figures() then has no figure for intensity.
    if (!has_intensities(frame.real)) names.erase(names.begin() + 1);
    const std::vector<ReportFigure> figures = comparison_figures(frame, "", "real", max_range_m);
    for (std::size_t k = 0; k < figures.size(); ++k) {
        std::vector<Image> strip;
        for (const auto& [caption, image] : figures[k].images) strip.push_back(image);
        write_png(folder / fmt::format("{}_{:06}.png", names[k], frame.frame),
                  stack_images(strip, stretch_factor(frame.real)));
    }
}

Image draw_ranges(const ScoredFrame& frame, double max_range_m) {
    return stack_images({draw_range(frame.real, max_range_m), draw_range(frame.rendered.image, max_range_m)},
                        stretch_factor(frame.real));
}

}  // namespace relidar::cli
