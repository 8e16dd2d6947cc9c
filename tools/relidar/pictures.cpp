// SPDX-License-Identifier: Apache-2.0
#include "pictures.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "evaluation.hpp"

namespace relidar::cli {
namespace {

constexpr float kDropThreshold = 0.5f;
constexpr float kRangeErrorScale_m = 1.0f;
constexpr float kIntensityErrorScale = 0.3f;
constexpr double kPictureAspect = 8.0;   // of one image in a stack: a LiDAR row is taller than its column is wide

std::vector<float> returned(const RangeImage& image) {
    std::vector<float> mask(image.range_m.size());
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = image.range_m[i] > 0.0f && image.drop_prob[i] < kDropThreshold ? 1.0f : 0.0f;
    return mask;
}

std::vector<float> both(std::vector<float> a, const std::vector<float>& b) {
    for (std::size_t i = 0; i < a.size(); ++i) a[i] *= b[i];
    return a;
}

std::vector<float> distance(const std::vector<float>& a, const std::vector<float>& b) {
    std::vector<float> result(a.size());
    for (std::size_t i = 0; i < a.size(); ++i) result[i] = std::abs(a[i] - b[i]);
    return result;
}

/// Near things are what a picture is for: colours run with the square root of the range.
std::vector<float> roots(std::vector<float> values) {
    for (float& v : values) v = std::sqrt(std::max(v, 0.0f));
    return values;
}

Image range_picture(const RangeImage& image, double max_range_m) {
    return colour_map(roots(image.range_m), image.rows, image.columns, 0.0f, static_cast<float>(std::sqrt(max_range_m)), "turbo", returned(image));
}

Image intensity_picture(const RangeImage& image) { return colour_map(image.intensity, image.rows, image.columns, 0.0f, 1.0f, "gray", returned(image)); }
Image drop_picture(const RangeImage& image) { return colour_map(image.drop_prob, image.rows, image.columns, 0.0f, 1.0f, "gray"); }

int stretch_of(const RangeImage& image) { return std::max(1, static_cast<int>(std::lround(image.columns / (kPictureAspect * image.rows)))); }

}  // namespace

std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title, const std::string& real_caption, double max_range_m) {
    const RangeImage& real = frame.real;
    const RangeImage& rendered = frame.rendered.image;
    const std::vector<float> mask = both(returned(real), returned(rendered));
    const auto error = [&](const std::vector<float>& a, const std::vector<float>& b, float scale, const std::vector<float>& shown) {
        return colour_map(distance(a, b), real.rows, real.columns, 0.0f, scale, "heat", shown);
    };
    return {{title + ": range",
             {{real_caption, range_picture(real, max_range_m)},
              {"rendered", range_picture(rendered, max_range_m)},
              {fmt::format("absolute error where both return, black 0 to white {} m", kRangeErrorScale_m), error(real.range_m, rendered.range_m, kRangeErrorScale_m, mask)}}},
            {title + ": intensity",
             {{real_caption, intensity_picture(real)},
              {"rendered", intensity_picture(rendered)},
              {fmt::format("absolute error where both return, black 0 to white {}", kIntensityErrorScale), error(real.intensity, rendered.intensity, kIntensityErrorScale, mask)}}},
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
            write_png(folder / fmt::format("{}_{:06}.png", kNames[k], frame.frame), stack(strip, stretch_of(frame.real)));
        }
    }
}

Image scan_picture(const RenderedScan& scan) {
    const RangeImage& image = scan.image;
    float farthest = 1.0f;
    for (const float range : image.range_m) farthest = std::max(farthest, range);
    return stack({range_picture(image, static_cast<double>(std::min(farthest, 80.0f))), intensity_picture(image), drop_picture(image)}, stretch_of(image));
}

Image range_pair(const ScoredFrame& frame, double max_range_m) {
    return stack({range_picture(frame.real, max_range_m), range_picture(frame.rendered.image, max_range_m)}, stretch_of(frame.real));
}

}  // namespace relidar::cli
