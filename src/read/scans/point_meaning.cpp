// SPDX-License-Identifier: Apache-2.0
#include "read/scans/point_meaning.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/files.hpp"
#include "read/files/dropped_ray.hpp"

namespace relidar::read {
namespace {

// Largest values of the usual intensity scales: percent, 8 bits and 16 bits.
constexpr double kPercentScale = 100.0, kByteScale = 255.0, kTwoByteScale = 65535.0;
constexpr double kFewBrighter = 0.995;  // share of the intensities within the scale of other files
// A position marks "no return" if (points at this position / all points) is between these
// limits, because measured points rarely have identical positions.
constexpr double kLeastMarked = 0.01, kMostMarked = 0.95;
constexpr std::size_t kFewestMarked = 16;

/// Selects the field that contains the intensities: the first candidate that has a value
/// other than 0. Adds a note if this is not the usual field.
void choose_intensity(const std::vector<PointTable>& clouds, PointFieldSemantics& semantics) {
    // all fields with a usual name of intensities, the most usual first
    const std::vector<std::string> names = clouds[0].list_fields(PointAttribute::intensity);
    if (names.empty()) return;
    const auto used = std::ranges::find_if(names, [&](const std::string& name) {
        return std::ranges::any_of(list_values(clouds, name), [](double value) { return value != 0.0; });
    });
    const bool are_all_zero = used == names.end();
    const std::string& chosen = are_all_zero ? names[0] : *used;
    semantics.intensity_field = chosen;
    if (are_all_zero)
        semantics.notes.push_back(fmt::format(
            "the field '{}', which usually contains intensities, is 0 for all points", quote(chosen)));
    else if (chosen != names[0])
        semantics.notes.push_back(
            fmt::format("intensities are read from the field '{}', because '{}' is 0 for all points",
                        quote(chosen), quote(names[0])));
    else if (chosen != "intensity" && chosen != "reflectivity")
        semantics.notes.push_back(fmt::format("intensities are read from the field '{}'", quote(chosen)));
}

/// Adds a note that names the fields that relidar ignores.
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

/// Adds notes if measured points have negative intensities, or intensities that are not
/// finite.
void note_bad_intensities(const std::vector<PointTable>& clouds, PointFieldSemantics& semantics) {
    double lowest = 0.0;
    std::size_t n_not_finite = 0, n_returns = 0;
    for (const PointTable& cloud : clouds) {
        const PointFieldView* values = cloud.find_field(semantics.intensity_field);
        if (!values) continue;
        const std::vector<glm::vec3> points = read_positions(cloud);
        values->for_each(cloud.n, [&](std::size_t i, double value) {
            if (!is_return_point(points[i])) return;
            ++n_returns;
            if (!std::isfinite(value)) ++n_not_finite;
            else lowest = std::min(lowest, value);
        });
    }
    if (lowest < 0.0)
        semantics.notes.push_back(
            fmt::format("some intensities are negative, down to {:.4g}; they are read as 0", lowest));
    if (n_not_finite > 0)
        semantics.notes.push_back(fmt::format(
            "{} of {} intensities in {} scans that were tested are NaN or infinite; they are read "
            "as 0",
            n_not_finite, n_returns, clouds.size()));
}

/// Returns the position that marks rays without a return, if many points share it. Some
/// files store all such rays as points at one position.
std::optional<glm::vec3> find_marker(const PointTable& cloud) {
    std::vector<glm::vec3> points = read_positions(cloud);
    std::erase_if(points, [](const glm::vec3& point) { return !is_return_point(point); });
    std::ranges::sort(points, {}, [](const glm::vec3& p) { return std::array{p.x, p.y, p.z}; });
    glm::vec3 marker(0.0f);
    std::size_t n_marked = 0;  // points at the most frequent position
    for (std::size_t begin = 0, end = 0; begin < points.size(); begin = end) {
        while (end < points.size() && points[end] == points[begin]) ++end;
        if (end - begin <= n_marked) continue;
        n_marked = end - begin;
        marker = points[begin];
    }
    const double share = double(n_marked) / double(cloud.n);
    const bool is_frequent = n_marked >= kFewestMarked && share >= kLeastMarked && share <= kMostMarked;
    return is_frequent ? std::optional(marker) : std::nullopt;
}

}  // namespace

std::vector<double> list_values(const std::vector<PointTable>& clouds, const std::string& field_name) {
    std::vector<double> values;
    for (const PointTable& cloud : clouds)
        if (const PointFieldView* field = cloud.find_field(field_name))
            field->for_each(cloud.n, [&](std::size_t, double value) { values.push_back(value); });
    return values;
}

IntensityScale estimate_scale(std::vector<double> intensities) {
    std::erase_if(intensities, [](double value) { return !std::isfinite(value); });
    if (intensities.empty()) return {};
    const auto [lowest, highest] = std::ranges::minmax(intensities);
    IntensityScale scale{.is_sure = lowest >= 0.0, .reason = "default"};
    if (highest <= 1.0) return scale;
    scale.reason = fmt::format("guess: the highest is {:.4g}", highest);
    if (highest <= kByteScale) {
        scale.max = kByteScale;
        // Values up to 100 can be percentages or bytes.
        if (highest <= kPercentScale) scale.is_sure = false;
        return scale;
    }
    if (highest > kTwoByteScale) scale.is_sure = false;
    // Few returns, such as those of reflectors, are much brighter than all others.
    const auto percentile =
        intensities.begin() + std::ptrdiff_t(kFewBrighter * double(intensities.size() - 1));
    std::nth_element(intensities.begin(), percentile, intensities.end());
    scale.max = std::max(*percentile, 1.0);
    scale.reason += fmt::format(", the {}th percentile is {:.4g}", 100.0 * kFewBrighter, scale.max);
    return scale;
}

PointFieldSemantics interpret_fields(const std::vector<PointTable>& sample_clouds) {
    PointFieldSemantics semantics;
    if (sample_clouds.empty()) return semantics;
    choose_intensity(sample_clouds, semantics);
    note_unread_fields(sample_clouds, semantics);

    semantics.scale = estimate_scale(list_values(sample_clouds, semantics.intensity_field));
    note_bad_intensities(sample_clouds, semantics);

    semantics.returns = find_unnumbered(sample_clouds);
    if (semantics.returns.exist)
        semantics.notes.push_back(
            "the points have two returns of each ray without numbers; equal returns are read as one return, "
            "and of two other returns the stronger is first");

    for (const PointTable& cloud : sample_clouds)
        if (!semantics.no_return) semantics.no_return = find_marker(cloud);
    if (semantics.no_return)
        semantics.notes.push_back(fmt::format(
            "many points have exactly the position ({}, {}, {}); they are read as rays without return",
            semantics.no_return->x, semantics.no_return->y, semantics.no_return->z));
    return semantics;
}

}  // namespace relidar::read
