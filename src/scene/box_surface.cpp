// SPDX-License-Identifier: Apache-2.0
// Divides the surface of a box into patches and stores which patches were observed. A
// line from the centre of the box through a point selects the patch of the point.
#include <relidar/scene/box_surface.hpp>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <utility>

#include "base/median.hpp"

namespace relidar {
namespace {

constexpr double kBoxPatch_m = 0.3;
// The ground hides the lowest part of a vertical side. Patches below this share of the
// height are ignored.
constexpr double kHiddenHeight = 0.2;
// Minimum number of mirrored pairs of patches from which the symmetry of an actor is
// measured.
constexpr std::size_t kFewestPairs = 3;
// Upper limit for the number of pairs of surface patches along an axis (a box of 120 m).
constexpr double kMostPairs = 200.0;

/// Returns the number of patches along a length. The number is even, so that the symmetry
/// plane y = 0 does not cut a patch.
int count_patches(double length_m) {
    return 2 * int(std::clamp(std::round(length_m / (2.0 * kBoxPatch_m)), 1.0, kMostPairs));
}

int find_patch(double along, double half_m, int count) {
    return std::clamp(int(std::floor((along / half_m + 1.0) * 0.5 * count)), 0, count - 1);
}

}  // namespace

const char* get_name(BoxSide side) {
    constexpr const char* kNames[] = {"front", "rear", "left", "right", "top"};
    return kNames[static_cast<int>(side)];
}

double get_min_side_cosine(BoxSide side) { return side == BoxSide::top ? 0.02 : 0.2; }

BoxSurface::BoxSurface(const glm::dvec3& size_m) : half_m_(0.5 * size_m) {
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        n_[s] = {count_patches(size_m[kSideFrames[s].first]), count_patches(size_m[kSideFrames[s].second])};
        seen_[s].assign(std::size_t(n_[s][0] * n_[s][1]), 0);
    }
}

/// Returns the surface patch where a line from the box centre through a point leaves the
/// box. Returns nothing if the line leaves through the bottom, or if the patch is too
/// close to the ground.
std::optional<BoxSurface::Patch> BoxSurface::find(const glm::dvec3& point_m) const {
    const glm::dvec3 share = point_m / half_m_, size = glm::abs(share);
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    if (!(size[axis] > 0.0) || !std::isfinite(size[axis]) || (axis == 2 && share.z < 0.0))
        return std::nullopt;
    const int side = axis == 2 ? int(BoxSide::top) : 2 * axis + (share[axis] < 0.0 ? 1 : 0);
    const SideFrame& frame = kSideFrames[side];
    const glm::dvec3 on_surface = point_m / size[axis];
    const Patch patch{BoxSide(side),
                      find_patch(on_surface[frame.first], half_m_[frame.first], n_[std::size_t(side)][0]),
                      find_patch(on_surface[frame.second], half_m_[frame.second], n_[std::size_t(side)][1])};
    return counts(patch) ? std::optional(patch) : std::nullopt;
}

bool BoxSurface::counts(const Patch& patch) const {
    return patch.side == BoxSide::top || (patch.row + 0.5) / n_[std::size_t(patch.side)][1] > kHiddenHeight;
}

BoxSurface::Patch BoxSurface::mirror(Patch patch) const {
    if (patch.side == BoxSide::left || patch.side == BoxSide::right)
        patch.side = patch.side == BoxSide::left ? BoxSide::right : BoxSide::left;
    else patch.column = n_[std::size_t(patch.side)][0] - 1 - patch.column;
    return patch;
}

bool BoxSurface::at(const Patch& patch) const {
    return seen_[std::size_t(patch.side)]
                [std::size_t(patch.row * n_[std::size_t(patch.side)][0] + patch.column)] != 0;
}

void BoxSurface::add(const glm::dvec3& point_m, const glm::dvec3& direction) {
    const std::optional<Patch> patch = find(point_m);
    if (!patch) return;
    const auto side = std::size_t(patch->side);
    const SideFrame& frame = kSideFrames[side];
    if (!(-frame.sign * direction[frame.normal] >= get_min_side_cosine(patch->side))) return;
    seen_[side][std::size_t(patch->row * n_[side][0] + patch->column)] = 1;
}

bool BoxSurface::is_seen(const glm::dvec3& point_m) const {
    const std::optional<Patch> patch = find(point_m);
    return patch && at(*patch);
}

bool BoxSurface::is_mirrored(const glm::dvec3& point_m) const {
    const std::optional<Patch> patch = find(point_m);
    return patch && !at(*patch) && at(mirror(*patch));
}

std::array<double, 2> BoxSurface::compute_patch_areas(BoxSide side, bool mirrored) const {
    const SideFrame& frame = kSideFrames[std::size_t(side)];
    const auto [columns, rows] = n_[std::size_t(side)];
    const double patch_m2 = 4.0 * half_m_[frame.first] * half_m_[frame.second] / (columns * rows);
    std::array<double, 2> sum{};
    for (int row = 0; row < rows; ++row) {
        for (int column = 0; column < columns; ++column) {
            const Patch patch{side, column, row};
            if (!counts(patch)) continue;
            const bool held = mirrored ? !at(patch) && at(mirror(patch)) : at(patch);
            sum[0] += held ? patch_m2 : 0.0, sum[1] += patch_m2;
        }
    }
    return sum;
}

double BoxSurface::share(bool mirrored) const {
    double held_m2 = 0.0, all_m2 = 0.0;
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        const std::array<double, 2> area = compute_patch_areas(BoxSide(s), mirrored);
        held_m2 += area[0], all_m2 += area[1];
    }
    return held_m2 / all_m2;
}

double BoxSurface::seen(BoxSide side) const {
    const std::array<double, 2> area = compute_patch_areas(side, false);
    return area[0] / area[1];
}

double BoxSurface::mirrored(BoxSide side) const {
    const std::array<double, 2> area = compute_patch_areas(side, true);
    return area[0] / area[1];
}

double BoxSurface::seen() const { return share(false); }
double BoxSurface::mirrored() const { return share(true); }

SideShares BoxSurface::known() const {
    SideShares shares{};
    for (std::size_t s = 0; s < kBoxSides; ++s)
        shares[s] = float(seen(BoxSide(s)) + (is_completed ? mirrored(BoxSide(s)) : 0.0));
    return shares;
}

std::optional<BoxSide> BoxSurface::find_completed_side(const glm::dvec3& point_m) const {
    const std::optional<Patch> patch = is_completed ? find(point_m) : std::nullopt;
    if (!patch || at(*patch) || !at(mirror(*patch))) return std::nullopt;
    return patch->side;
}

double BoxSurface::compute_asymmetry_m(const std::vector<glm::vec3>& points_m) const {
    struct Mean {
        double sum_m = 0.0;
        int n = 0;
    };
    std::map<std::array<int, 3>, Mean> outward;
    for (const glm::vec3& point_m : points_m) {
        const std::optional<Patch> patch = find(glm::dvec3(point_m));
        if (!patch || !at(*patch)) continue;
        Mean& mean = outward[{int(patch->side), patch->column, patch->row}];
        mean.sum_m += std::abs(double(point_m[kSideFrames[std::size_t(patch->side)].normal])), ++mean.n;
    }
    std::vector<double> differences_m;
    for (const auto& [key, here] : outward) {
        const Patch other = mirror({BoxSide(key[0]), key[1], key[2]});
        const auto there = outward.find({int(other.side), other.column, other.row});
        if (there != outward.end() && key < there->first)
            differences_m.push_back(std::abs(here.sum_m / here.n - there->second.sum_m / there->second.n));
    }
    return differences_m.size() < kFewestPairs ? 0.0 : compute_median(std::move(differences_m));
}

std::string BoxSurface::patches(BoxSide side) const {
    std::string text;
    for (const char is_seen : seen_[std::size_t(side)]) text += is_seen ? '1' : '0';
    return text;
}

bool BoxSurface::parse_patches(BoxSide side, const std::string& text) {
    std::vector<char>& patches = seen_[std::size_t(side)];
    if (text.size() != patches.size() || text.find_first_not_of("01") != std::string::npos) return false;
    std::ranges::transform(text, patches.begin(), [](char character) { return char(character == '1'); });
    return true;
}

std::string list_unseen_sides(const SideShares& shares) {
    std::string names;
    for (std::size_t s = 0; s < kBoxSides; ++s)
        if (shares[s] < kUnseenSide) names += (names.empty() ? "" : ", ") + std::string(get_name(BoxSide(s)));
    return names;
}

}  // namespace relidar
