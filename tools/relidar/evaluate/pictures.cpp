// SPDX-License-Identifier: Apache-2.0
#include "evaluate/pictures.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include <relidar/base/math.hpp>
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

/// Draws each ray of a sensor as a dot whose colour shows its firing time. Azimuth
/// increases to the right and elevation upwards.
Image draw_ray_pattern(const RayTable& rays) {
    constexpr double kViewSector_rad = 20.0 * kPi / 180.0, kViewMargin_rad = 0.5 * kPi / 180.0;
    constexpr int kPictureWidth_px = 1200, kDotSize_px = 2;
    std::vector<glm::dvec2> angle;  // Azimuth and elevation of each ray.
    for (const glm::vec3& d : rays.direction)
        angle.emplace_back(std::atan2(double(d.y), double(d.x)),
                           std::asin(std::clamp(double(d.z), -1.0, 1.0)));
    glm::dvec2 low = angle.front(), high = angle.front();
    for (const glm::dvec2& a : angle) {
        low = glm::min(low, a);
        high = glm::max(high, a);
    }
    // A sensor that covers a full turn would be too wide, so shows only the 40 degrees
    // ahead.
    if (high.x - low.x > 1.9 * kPi) {
        low.x = -kViewSector_rad;
        high.x = kViewSector_rad;
    }
    low -= kViewMargin_rad;
    high += kViewMargin_rad;
    const double pixels_per_rad = kPictureWidth_px / (high.x - low.x);
    const int rows = std::clamp(static_cast<int>((high.y - low.y) * pixels_per_rad), 1, 8 * kPictureWidth_px);
    std::vector<float> seconds(std::size_t(rows) * kPictureWidth_px, std::numeric_limits<float>::quiet_NaN());
    for (std::size_t i = 0; i < angle.size(); ++i) {
        const int row = static_cast<int>((high.y - angle[i].y) * pixels_per_rad),
                  column = static_cast<int>((high.x - angle[i].x) * pixels_per_rad);
        for (int y = std::max(row, 0); y < std::min(row + kDotSize_px, rows); ++y)
            for (int x = std::max(column, 0); x < std::min(column + kDotSize_px, kPictureWidth_px); ++x)
                seconds[std::size_t(y) * kPictureWidth_px + std::size_t(x)] = rays.time_offset_s[i];
    }
    const auto drawn = [](float value) { return !std::isnan(value); };
    const auto first = std::ranges::find_if(seconds, drawn);
    float earliest = first == seconds.end() ? 0.0f : *first, latest = earliest;
    for (const float value : seconds)
        if (drawn(value)) {
            earliest = std::min(earliest, value);
            latest = std::max(latest, value);
        }
    return apply_colour_map(seconds, rows, kPictureWidth_px, earliest,
                            std::max(latest, std::nextafter(earliest, 1e30f)), "turbo");
}

}  // namespace relidar::cli
