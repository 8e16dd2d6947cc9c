// SPDX-License-Identifier: Apache-2.0
#include "pictures.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "evaluation.hpp"
#include <relidar/scan_files.hpp>

namespace relidar::cli {
namespace {

constexpr float kRangeErrorScale_m = 1.0f;
constexpr float kIntensityErrorScale = 0.3f;

std::vector<float> both(std::vector<float> a, const std::vector<float>& b) {
    for (std::size_t i = 0; i < a.size(); ++i) a[i] *= b[i];
    return a;
}

std::vector<float> distance(const std::vector<float>& a, const std::vector<float>& b) {
    std::vector<float> result(a.size());
    for (std::size_t i = 0; i < a.size(); ++i) result[i] = std::abs(a[i] - b[i]);
    return result;
}

}  // namespace

std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title, const std::string& real_caption,
                                             double max_range_m) {
    const RangeImage& real = frame.real;
    const RangeImage& rendered = frame.rendered.image;
    const std::vector<float> mask = both(returned_pixels(real), returned_pixels(rendered));
    const auto error = [&](const std::vector<float>& a, const std::vector<float>& b, float scale, const std::vector<float>& shown) {
        return colour_map(distance(a, b), real.rows, real.columns, 0.0f, scale, "heat", shown);
    };
    return {{title + ": range",
             {{real_caption, range_picture(real, max_range_m)},
              {"rendered", range_picture(rendered, max_range_m)},
              {fmt::format("absolute error where both return, black 0 to white {} m", kRangeErrorScale_m),
               error(real.range_m, rendered.range_m, kRangeErrorScale_m, mask)}}},
            {title + ": intensity",
             {{real_caption, intensity_picture(real)},
              {"rendered", intensity_picture(rendered)},
              {fmt::format("absolute error where both return, black 0 to white {}", kIntensityErrorScale),
               error(real.intensity, rendered.intensity, kIntensityErrorScale, mask)}}},
            {title + ": ray drop",
             {{real_caption + ", white: dropped", drop_picture(real)},
              {"rendered drop probability", drop_picture(rendered)},
              {"absolute error, black 0 to white 1", error(real.drop_prob, rendered.drop_prob, 1.0f, {})}}}};
}

void write_strips(const std::filesystem::path& folder, const Evaluation& evaluation, double max_range_m) {
    constexpr const char* kNames[] = {"range", "intensity", "drop"};   // in the order of comparison_figures
    for (const ScoredFrame& frame : evaluation.frames) {
        const std::vector<ReportFigure> figures = comparison_figures(frame, "", "real", max_range_m);
        for (std::size_t k = 0; k < figures.size(); ++k) {
            std::vector<Image> strip;
            for (const auto& [caption, image] : figures[k].images) strip.push_back(image);
            write_png(folder / fmt::format("{}_{:06}.png", kNames[k], frame.frame), stack(strip, picture_stretch(frame.real)));
        }
    }
}

Image range_pair(const ScoredFrame& frame, double max_range_m) {
    return stack({range_picture(frame.real, max_range_m), range_picture(frame.rendered.image, max_range_m)}, picture_stretch(frame.real));
}

}  // namespace relidar::cli
