// SPDX-License-Identifier: Apache-2.0
// Divides the surface of a box into patches and stores which patches were observed. A
// line from the centre of the box through a point selects the patch of the point.

#include <cmath>
#include <map>
#include <utility>

#include <relidar/scene/box_surface.hpp>
#include <relidar/scene/labels.hpp>

#include "base/geometry/ray_box.hpp"
#include "base/median.hpp"

namespace relidar {
namespace {

constexpr double kBoxPatch_m = 0.3;
constexpr double kHiddenHeight = 0.2;    // lowest share of a vertical side, which the ground hides
constexpr std::size_t kFewestPairs = 3;  // minimum number of mirrored pairs of patches for a symmetry
constexpr double kMostPairs = 200.0;     // maximum number of pairs of patches along an axis: a box of 120 m

/// Returns the number of patches along a length. The number is even, so that the symmetry
/// plane y = 0 does not cut a patch.
int count_patches(double length_m) {
    return 2 * int(std::clamp(std::round(length_m / (2.0 * kBoxPatch_m)), 1.0, kMostPairs));
}

/// Returns the patch at a coordinate along a length from -half_length_m to half_length_m.
int patch_index(double coordinate_m, double half_length_m, int n_patches) {
    return std::clamp(int(std::floor((coordinate_m / half_length_m + 1.0) * 0.5 * n_patches)), 0,
                      n_patches - 1);
}

// Maximum distance between the left and the mirrored right surface of a symmetric object.
// The middle of a too large box is not exactly its symmetry plane.
constexpr double kMostAsymmetry_m = 0.15;
constexpr int kOddInY[] = {1, 4, 5, 9, 10, 11};  // spherical harmonics that are odd in y (negative order)

}  // namespace

const char* name_of(BoxSide side) {
    constexpr const char* kSideNames[] = {"front", "rear", "left", "right", "top"};
    return kSideNames[static_cast<int>(side)];
}

double min_cosine(BoxSide side) { return side == BoxSide::top ? 0.02 : 0.2; }

ObservedBoxSurface::ObservedBoxSurface(const glm::dvec3& size_m) : half_m_(0.5 * size_m) {
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        n_[s] = {count_patches(size_m[kSideFrames[s].first]), count_patches(size_m[kSideFrames[s].second])};
        observed_patches_[s].assign(std::size_t(n_[s][0]) * std::size_t(n_[s][1]), 0);
    }
}

/// Returns the patch where a line from the box centre through a point leaves the box.
auto ObservedBoxSurface::find_patch(const glm::dvec3& point_m) const -> std::optional<BoxSurfacePatch> {
    // In units of the half size, the line leaves the box along the largest coordinate.
    const glm::dvec3 in_cube = point_m / half_m_;
    const int axis = longest_axis(glm::abs(in_cube));
    const double largest = std::abs(in_cube[axis]);
    const bool is_bottom = axis == 2 && in_cube.z < 0.0;
    if (is_bottom || !(largest > 0.0) || !std::isfinite(largest)) return std::nullopt;
    // Sides in the order of BoxSide: +x, -x, +y, -y, +z.
    const int side = axis == 2 ? int(BoxSide::top) : 2 * axis + int(in_cube[axis] < 0.0);
    const BoxSideAxes& frame = kSideFrames[side];
    const auto [columns, rows] = n_[std::size_t(side)];
    const glm::dvec3 exit_m = point_m / largest;
    const BoxSurfacePatch patch{BoxSide(side),
                                patch_index(exit_m[frame.first], half_m_[frame.first], columns),
                                patch_index(exit_m[frame.second], half_m_[frame.second], rows)};
    return is_above_ground(patch) ? std::optional(patch) : std::nullopt;
}

bool ObservedBoxSurface::is_above_ground(const BoxSurfacePatch& patch) const {
    return patch.side == BoxSide::top || (patch.row + 0.5) / n_[std::size_t(patch.side)][1] > kHiddenHeight;
}

ObservedBoxSurface::BoxSurfacePatch ObservedBoxSurface::mirror_patch(BoxSurfacePatch patch) const {
    if (patch.side == BoxSide::left || patch.side == BoxSide::right)
        patch.side = patch.side == BoxSide::left ? BoxSide::right : BoxSide::left;
    else patch.column = n_[std::size_t(patch.side)][0] - 1 - patch.column;
    return patch;
}

std::size_t ObservedBoxSurface::index_of_patch(const BoxSurfacePatch& patch) const {
    return std::size_t(patch.row) * std::size_t(n_[std::size_t(patch.side)][0]) + std::size_t(patch.column);
}

bool ObservedBoxSurface::is_patch_set(const BoxSurfacePatch& patch) const {
    return observed_patches_[std::size_t(patch.side)][index_of_patch(patch)] != 0;
}

void ObservedBoxSurface::mark_observed(const glm::dvec3& point_m, const glm::dvec3& direction) {
    const std::optional<BoxSurfacePatch> patch = find_patch(point_m);
    if (!patch) return;
    const auto side = std::size_t(patch->side);
    const BoxSideAxes& frame = kSideFrames[side];
    if (!(-frame.sign * direction[frame.normal] >= min_cosine(patch->side))) return;
    observed_patches_[side][index_of_patch(*patch)] = 1;
}

bool ObservedBoxSurface::is_observed(const glm::dvec3& point_m) const {
    const std::optional<BoxSurfacePatch> patch = find_patch(point_m);
    return patch && is_patch_set(*patch);
}

bool ObservedBoxSurface::is_mirror_observed(const glm::dvec3& point_m) const {
    const std::optional<BoxSurfacePatch> patch = find_patch(point_m);
    return patch && !is_patch_set(*patch) && is_patch_set(mirror_patch(*patch));
}

/// Returns the share of the area of one side, or of all sides, whose patches were
/// observed. Patches are the cells of a regular grid on each side. The mirror patch is at
/// the opposite y. Leaves out patches near the ground.
/// @param only_mirrored if true, counts the patches of which only the mirror patch was
/// observed, instead of the observed patches
double ObservedBoxSurface::compute_area_fraction(std::optional<BoxSide> only_side, bool only_mirrored) const {
    const auto is_counted = [&](const BoxSurfacePatch& patch) {
        if (only_mirrored) return !is_patch_set(patch) && is_patch_set(mirror_patch(patch));
        return is_patch_set(patch);
    };
    double counted_m2 = 0.0, all_m2 = 0.0;
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        if (only_side && BoxSide(s) != *only_side) continue;
        const BoxSideAxes& frame = kSideFrames[s];
        const auto [columns, rows] = n_[s];
        // All patches of a side have the same area.
        const double patch_m2 = 4.0 * half_m_[frame.first] * half_m_[frame.second] / (columns * rows);
        double side_counted_m2 = 0.0, side_m2 = 0.0;
        for (int row = 0; row < rows; ++row)
            for (int column = 0; column < columns; ++column) {
                const BoxSurfacePatch patch{BoxSide(s), column, row};
                if (!is_above_ground(patch)) continue;
                if (is_counted(patch)) side_counted_m2 += patch_m2;
                side_m2 += patch_m2;
            }
        counted_m2 += side_counted_m2;
        all_m2 += side_m2;
    }
    return counted_m2 / all_m2;
}

double ObservedBoxSurface::observed_fraction(std::optional<BoxSide> side) const {
    return compute_area_fraction(side, false);
}
double ObservedBoxSurface::mirrorable_fraction(std::optional<BoxSide> side) const {
    return compute_area_fraction(side, true);
}

ObservedSideFractions ObservedBoxSurface::covered_sides() const {
    ObservedSideFractions shares{};
    for (std::size_t s = 0; s < kBoxSides; ++s)
        shares[s] =
            float(observed_fraction(BoxSide(s)) + (is_completed ? mirrorable_fraction(BoxSide(s)) : 0.0));
    return shares;
}

std::optional<BoxSide> ObservedBoxSurface::find_mirrored_side(const glm::dvec3& point_m) const {
    const std::optional<BoxSurfacePatch> patch = is_completed ? find_patch(point_m) : std::nullopt;
    if (!patch || is_patch_set(*patch) || !is_patch_set(mirror_patch(*patch))) return std::nullopt;
    return patch->side;
}

double ObservedBoxSurface::asymmetry_m(const std::vector<glm::vec3>& points_m) const {
    // Distances of a patch's points from the box centre, along the normal of the side.
    struct DistanceSum {
        double sum_m = 0.0;
        int n = 0;
        double mean_m() const { return sum_m / n; }
    };
    std::map<BoxSurfacePatch, DistanceSum> distances;
    for (const glm::vec3& point_m : points_m) {
        const std::optional<BoxSurfacePatch> patch = find_patch(glm::dvec3(point_m));
        if (!patch || !is_patch_set(*patch)) continue;
        const int normal_axis = kSideFrames[std::size_t(patch->side)].normal;  // x, y or z of the box
        DistanceSum& distance = distances[*patch];
        distance.sum_m += std::abs(double(point_m[normal_axis]));
        ++distance.n;
    }
    std::vector<double> differences_m;  // of the means of a patch and its mirror patch
    for (const auto& [patch, distance] : distances) {
        const auto mirrored = distances.find(mirror_patch(patch));
        // The order of the patches counts each pair once.
        if (mirrored == distances.end() || !(patch < mirrored->first)) continue;
        differences_m.push_back(std::abs(distance.mean_m() - mirrored->second.mean_m()));
    }
    return differences_m.size() < kFewestPairs ? 0.0 : compute_median(std::move(differences_m));
}

std::string ObservedBoxSurface::format_patches(BoxSide side) const {
    std::string text;
    for (const char observed_flag : observed_patches_[std::size_t(side)]) text += observed_flag ? '1' : '0';
    return text;
}

bool ObservedBoxSurface::parse_patches(BoxSide side, const std::string& text) {
    std::vector<char>& patches = observed_patches_[std::size_t(side)];
    if (text.size() != patches.size() || text.find_first_not_of("01") != std::string::npos) return false;
    std::ranges::transform(text, patches.begin(), [](char character) { return char(character == '1'); });
    return true;
}

std::string list_unseen_sides(const ObservedSideFractions& observed_fractions) {
    std::string names;
    for (std::size_t s = 0; s < kBoxSides; ++s)
        if (observed_fractions[s] < kUnseenSide)
            names += (names.empty() ? "" : ", ") + std::string(name_of(BoxSide(s)));
    return names;
}

bool is_vehicle(const BoxTrack& box) { return guess_kind(box) == ObjectKind::vehicle; }

Surfels mirror_surfels(Surfels surfels) {
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        surfels.mean[i].y *= -1.0f;
        if (surfels.bends) surfels.gait[i].swing.y *= -1.0f;
        // The mirrored rotation has a mirrored axis and turns in the opposite direction.
        // So x and z of the quaternion change their signs, and y does not.
        glm::vec4& q = surfels.rotation[i];  // (w, x, y, z)
        q = {q[0], -q[1], q[2], -q[3]};
        for (int channel = 0; channel < kShChannels; ++channel)
            for (const int k : kOddInY)
                surfels.sh[i * kShFloats + std::size_t(channel * kShCoefficients + k)] *= -1.0f;
    }
    return surfels;
}

std::size_t mirror_unobserved(Surfels& surfels, ObservedBoxSurface& surface) {
    // Compares the two sides where the surface is opaque (opacity above 0.5).
    std::vector<glm::vec3> opaque_m;
    for (std::size_t i = 0; i < surfels.size(); ++i)
        if (surfels.opacity_logit[i] > 0.0f) opaque_m.push_back(surfels.mean[i]);
    if (surface.asymmetry_m(opaque_m) > kMostAsymmetry_m) return 0;
    std::vector<std::uint32_t> remaining, copied;
    for (std::uint32_t i = 0; i < surfels.size(); ++i) {
        const glm::dvec3 position(surfels.mean[i]), mirrored(position.x, -position.y, position.z);
        // A mirrored surfel replaces this one if only the mirror patch was observed.
        if (!surface.is_mirror_observed(position)) remaining.push_back(i);
        // The mirror image of this surfel would fill an unobserved patch.
        if (surface.is_mirror_observed(mirrored)) copied.push_back(i);
    }
    if (copied.empty()) return 0;
    const Surfels mirrored_surfels = mirror_surfels(surfels.reorder(copied));
    surfels = surfels.reorder(remaining);
    surfels.append_surfels(mirrored_surfels);
    surface.is_completed = true;
    return copied.size();
}

}  // namespace relidar
