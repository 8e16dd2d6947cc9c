// SPDX-License-Identifier: Apache-2.0
#include "read/scans/point_meaning.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/files.hpp"
#include "read/scans/dropped_ray.hpp"

namespace relidar::read {
namespace {

// Largest values of the usual intensity scales: percent, 8 bits and 16 bits.
constexpr double kPercentScale = 100.0, kByteScale = 255.0, kTwoByteScale = 65535.0;
constexpr double kFewBrighter = 0.995;  // minimum share of the intensities that must be within the scale
// A position marks "no return" if (points at this position / all points) is between these
// limits, because measured points rarely have identical positions.
constexpr double kLeastMarked = 0.01, kMostMarked = 0.95;
constexpr std::ptrdiff_t kFewestMarked = 16;
constexpr std::size_t kMaxTestedPoints =
    1024;  // maximum number of points that are tested for repeated positions

bool is_all_zero(const std::vector<PointTable>& clouds, const std::string& field_name) {
    bool is_zero = true;
    for (const PointTable& cloud : clouds)
        if (const PointFieldView* values = cloud.find_field(field_name))
            values->for_each(cloud.n,
                             [&](std::size_t, double value) { is_zero = is_zero && !(value != 0.0); });
    return is_zero;
}

/// Selects the field that contains the intensities: the first candidate that has a value
/// other than 0. Adds a note if this is not the usual field.
void choose_intensity(const std::vector<PointTable>& clouds, PointFieldSemantics& semantics) {
    const std::vector<std::string> names = clouds[0].list_fields(PointAttribute::intensity);
    if (names.empty()) return;
    const auto used =
        std::ranges::find_if(names, [&](const std::string& name) { return !is_all_zero(clouds, name); });
    semantics.intensity_field = used == names.end() ? names[0] : *used;
    const bool is_usual =
        semantics.intensity_field == "intensity" || semantics.intensity_field == "reflectivity";
    if (used == names.end())
        semantics.notes.push_back(fmt::format(
            "the field '{}', which usually contains intensities, is 0 for all points", quote(names[0])));
    else if (used != names.begin())
        semantics.notes.push_back(
            fmt::format("intensities are read from the field '{}', because '{}' is 0 for all points",
                        quote(*used), quote(names[0])));
    else if (!is_usual)
        semantics.notes.push_back(fmt::format("intensities are read from the field '{}'", quote(*used)));
}

void note_unread_fields(const std::vector<PointTable>& clouds, PointFieldSemantics& semantics) {
    std::set<std::string> unread;
    for (const PointTable& cloud : clouds)
        for (const std::string& name : cloud.unread) unread.insert(quote(name));
    if (unread.empty()) return;
    semantics.notes.push_back(fmt::format(
        "these fields of the points are not read: {} (field of the intensities: {})", fmt::join(unread, ", "),
        semantics.intensity_field.empty() ? "none, because no field has a usual name of intensities"
                                          : "'" + quote(semantics.intensity_field) + "'"));
}

/// Returns a note, or an empty text.
std::string describe_negatives(const std::vector<PointTable>& clouds, const std::string& field) {
    double lowest = 0.0;
    for (const PointTable& cloud : clouds) {
        const PointFieldView* values = cloud.find_field(field);
        if (!values) continue;
        const std::vector<glm::vec3> points = read_positions(cloud);
        values->for_each(cloud.n, [&](std::size_t i, double value) {
            if (value < lowest && is_return_point(points[i])) lowest = value;
        });
    }
    return lowest < 0.0
               ? fmt::format("some intensities are negative, down to {:.4g}; they are read as 0", lowest)
               : "";
}

/// Returns the position that marks rays without a return, if many points share it. Some
/// files store all such rays as points at one position.
std::optional<glm::vec3> find_marker(const PointTable& cloud) {
    const std::vector<glm::vec3> points = read_positions(cloud);
    std::vector<glm::vec3> some;
    const std::size_t n = std::min(kMaxTestedPoints, points.size());
    for (std::size_t k = 0; k < n; ++k)
        if (const glm::vec3& p = points[k * points.size() / n]; is_return_point(p)) some.push_back(p);
    std::ranges::sort(some, {}, [](const glm::vec3& p) { return std::array{p.x, p.y, p.z}; });
    std::size_t most = 0, last = 0;
    for (std::size_t k = 0, run = 0; k < some.size(); ++k) {
        run = k > 0 && some[k] == some[k - 1] ? run + 1 : 1;
        if (run > most) {
            most = run;
            last = k;
        }
    }
    // The sample gives a candidate, which must then be frequent among all points.
    if (most < 3) return std::nullopt;
    const auto n_marked = std::ranges::count(points, some[last]);
    const double share = double(n_marked) / double(points.size());
    if (n_marked < kFewestMarked || share < kLeastMarked || share > kMostMarked) return std::nullopt;
    return some[last];
}

}  // namespace

IntensityScale estimate_scale(std::vector<double>& intensities) {
    std::erase_if(intensities, [](double value) { return !std::isfinite(value); });
    if (intensities.empty()) return {};
    const auto [lowest, highest] = std::ranges::minmax(intensities);
    IntensityScale scale;
    // Values up to 100 can be percentages or bytes, so their scale is not sure.
    scale.is_sure =
        lowest >= 0.0 && (highest <= 1.0 || (highest > kPercentScale && highest <= kTwoByteScale));
    if (highest <= 1.0) return scale;
    if (highest <= kByteScale) {
        scale.max = kByteScale;
        scale.about = fmt::format("intensities up to {:.4g} are divided by 255{}", highest,
                                  scale.is_sure ? "" : ", but they could also be percentages");
        return scale;
    }
    const auto at = intensities.begin() + std::ptrdiff_t(kFewBrighter * double(intensities.size() - 1));
    std::nth_element(intensities.begin(), at, intensities.end());
    scale.max = std::max(*at, 1.0);
    scale.about =
        fmt::format("intensities go up to {:.4g}; they are divided by {:.4g}, their 99.5th percentile",
                    highest, scale.max);
    return scale;
}

PointFieldSemantics interpret_fields(const std::vector<PointTable>& sample_clouds) {
    PointFieldSemantics meaning;
    if (sample_clouds.empty()) return meaning;
    choose_intensity(sample_clouds, meaning);
    note_unread_fields(sample_clouds, meaning);
    std::vector<double> intensities;
    for (const PointTable& cloud : sample_clouds)
        if (const PointFieldView* values = cloud.find_field(meaning.intensity_field))
            values->for_each(cloud.n, [&](std::size_t, double value) { intensities.push_back(value); });
    meaning.scale = estimate_scale(intensities);
    meaning.returns = find_unnumbered(sample_clouds);
    if (const std::string text = describe_negatives(sample_clouds, meaning.intensity_field); !text.empty())
        meaning.notes.push_back(text);
    if (meaning.returns.exist) meaning.notes.push_back(meaning.returns.about);
    for (const PointTable& cloud : sample_clouds)
        if (!meaning.no_return) meaning.no_return = find_marker(cloud);
    if (meaning.no_return)
        meaning.notes.push_back(fmt::format(
            "many points have exactly the position ({}, {}, {}); they are read as rays without return",
            meaning.no_return->x, meaning.no_return->y, meaning.no_return->z));
    return meaning;
}

}  // namespace relidar::read
