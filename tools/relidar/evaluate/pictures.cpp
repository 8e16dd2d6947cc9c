// SPDX-License-Identifier: Apache-2.0
#include "evaluate/pictures.hpp"

#include <cmath>

#include <fmt/format.h>

#include <relidar/log/sensor.hpp>
#include <relidar/simulate/scan_files.hpp>
#include "evaluate/evaluation.hpp"

namespace relidar::cli {
namespace {

constexpr float kRangeErrorScale_m = 1.0f;
constexpr float kIntensityErrorScale = 0.3f;

/// Draws the absolute difference of two images. `scale` is the error at the upper end of
/// the colours, and pixels whose mask is 0 are left out.
Image draw_error(const RangeImage& shape, const std::vector<float>& first, const std::vector<float>& second,
                 float scale, const std::vector<float>& mask) {
    std::vector<float> differences(first.size());
    for (std::size_t i = 0; i < first.size(); ++i) differences[i] = std::abs(first[i] - second[i]);
    return apply_colour_map(differences, shape.rows, shape.columns, 0.0f, scale, "heat", mask);
}

/// Draws the ray drop. If a network has corrected the drop probabilities, also shows them
/// before the correction.
ReportFigure drop_figure(const ScoredFrame& frame, const std::string& title,
                         const std::string& real_caption) {
    const RangeImage& real = frame.real;
    const RangeImage& rendered = frame.rendered.image;
    ReportFigure drops{title + ": ray drop", {{real_caption + ", white: dropped rays", draw_drop(real)}}};
    if (const auto* of_surfels = find_values<float>(frame.rendered.channels, "surfel_drop_prob")) {
        RangeImage uncorrected = rendered;
        uncorrected.drop_prob = *of_surfels;
        drops.images.emplace_back("drop probability of the surfels", draw_drop(uncorrected));
        drops.images.emplace_back("absolute error of the drop probability of the surfels",
                                  draw_error(real, real.drop_prob, uncorrected.drop_prob, 1.0f, {}));
        drops.images.emplace_back("rendered drop probability, corrected by the network", draw_drop(rendered));
    } else {
        drops.images.emplace_back("rendered drop probability", draw_drop(rendered));
    }
    drops.images.emplace_back("absolute error of the drop probability, black: 0, white: 1",
                              draw_error(real, real.drop_prob, rendered.drop_prob, 1.0f, {}));
    return drops;
}

}  // namespace

/// Returns pictures of a real scan, the rendered scan and their difference, for range,
/// intensity and ray drop.
std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title,
                                             const std::string& real_caption, double max_range_m) {
    const RangeImage& real = frame.real;
    const RangeImage& rendered = frame.rendered.image;
    // Only rays that return in both images have a range error. Their mask is 1.
    std::vector<float> mask = return_mask(real);
    const std::vector<float> rendered_mask = return_mask(rendered);
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] *= rendered_mask[i];
    std::vector<ReportFigure> figures = {
        {title + ": range",
         {{real_caption, draw_range(real, max_range_m)},
          {"rendered", draw_range(rendered, max_range_m)},
          {fmt::format("absolute error of rays that return in both scans, black: 0, white: {} m",
                       kRangeErrorScale_m),
           draw_error(real, real.range_m, rendered.range_m, kRangeErrorScale_m, mask)}}}};
    if (has_intensities(real))
        figures.push_back(
            {title + ": intensity",
             {{real_caption, draw_intensity(real)},
              {"rendered", draw_intensity(rendered)},
              {fmt::format("absolute error of rays that return in both scans, black: 0, white: {}",
                           kIntensityErrorScale),
               draw_error(real, real.intensity, rendered.intensity, kIntensityErrorScale, mask)}}});
    figures.push_back(drop_figure(frame, title, real_caption));
    return figures;
}

void write_comparison(const std::filesystem::path& folder, const ScoredFrame& frame, double max_range_m) {
    // The order of comparison_figures().
    std::vector<const char*> names{"range"};
    if (has_intensities(frame.real)) names.push_back("intensity");
    names.push_back("drop");
    const std::vector<ReportFigure> figures = comparison_figures(frame, "", "real", max_range_m);
    for (std::size_t i = 0; i < figures.size(); ++i) {
        std::vector<Image> images;
        for (const auto& [caption, image] : figures[i].images) images.push_back(image);
        write_png(folder / fmt::format("{}_{:06}.png", names[i], frame.frame),
                  stack_images(images, stretch_factor(frame.real)));
    }
}

Image draw_ranges(const ScoredFrame& frame, double max_range_m) {
    return stack_images({draw_range(frame.real, max_range_m), draw_range(frame.rendered.image, max_range_m)},
                        stretch_factor(frame.real));
}

}  // namespace relidar::cli
