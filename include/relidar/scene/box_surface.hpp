// SPDX-License-Identifier: Apache-2.0
// Surface of an actor's box. Stores which parts of the surface the log has observed.
#pragma once

#include <array>
#include <compare>
#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// Sides of the box of an actor, without the bottom.
enum class BoxSide { front, rear, left, right, top };
inline constexpr std::size_t kBoxSides = 5;
/// Returns the name of a side: "front", "rear", "left", "right" or "top".
const char* name_of(BoxSide side);

/// Axes of a side of a box: its outward normal is axis `normal` with the sign `sign`.
/// Patches divide it along the axes `first` and `second`, on vertical sides the height.
struct BoxSideAxes {
    int normal;
    double sign;
    int first, second;
};
inline constexpr BoxSideAxes kSideFrames[kBoxSides] = {
    {0, 1.0, 1, 2}, {0, -1.0, 1, 2}, {1, 1.0, 0, 2}, {1, -1.0, 0, 2}, {2, 1.0, 1, 0}};

/// Observed fraction of each side of a box, 0 to 1, in the order of BoxSide.
using ObservedSideFractions = std::array<float, kBoxSides>;
/// A side whose observed fraction is below this counts as unseen.
inline constexpr float kUnseenSide = 0.1f;
/// Returns the names of the unseen sides, for example "rear, left".
std::string list_unseen_sides(const ObservedSideFractions& observed_fractions);
/// Returns the minimum cosine between a ray and the normal of a side. More grazing rays
/// do not count, because their returns form separate streaks. The limit of the top is
/// lower, because a LiDAR on a car hits other roofs only at grazing angles.
double min_cosine(BoxSide side);

/// Surface of a box, divided into patches of about 0.3 m, and which of them were observed
/// by rays. A point belongs to the patch onto which it projects from the centre of the
/// box. The lowest fifth of the four sides is ignored, because it is hidden near the
/// ground. Every patch has a mirror patch on the other side of the x-z plane.
class ObservedBoxSurface {
public:
    /// Divides a box surface into patches, none of which is observed yet.
    /// @param size_m [3] length, width, height, all above 0
    explicit ObservedBoxSurface(const glm::dvec3& size_m);
    bool operator==(const ObservedBoxSurface&) const = default;
    /// Marks the patch of a point as observed by a ray (both in the box frame) that hits
    /// the side from outside and does not graze it. Rays from inside have passed through
    /// a window to the far side.
    void mark_observed(const glm::dvec3& point_m, const glm::dvec3& direction);
    /// Returns true if a ray has observed the patch of a point.
    bool is_observed(const glm::dvec3& point_m) const;
    /// Returns true if only the mirror patch of a point was observed.
    bool is_mirror_observed(const glm::dvec3& point_m) const;
    /// Returns the observed fraction, by area, of a side or of the complete surface, 0 to
    /// 1.
    double observed_fraction(std::optional<BoxSide> side = {}) const;
    /// Returns the fraction that was not observed, but whose mirror image was.
    double mirrorable_fraction(std::optional<BoxSide> side = {}) const;

    /// If true, unobserved patches got mirrored surfels if their mirror patches were
    /// observed.
    bool is_completed = false;
    /// Returns the observed fraction of each side, including completed patches.
    ObservedSideFractions covered_sides() const;
    /// Returns the side of the box if the point is in a completed patch.
    std::optional<BoxSide> find_mirrored_side(const glm::dvec3& point_m) const;
    /// Measures how much the left and right half of an object differ: compares the mean
    /// distances of the points of two mirrored patches from the middle of the box.
    /// @param points_m points of the surface, box frame
    /// @return median difference over all pairs of observed patches, metres; 0 with fewer
    /// than three pairs
    double asymmetry_m(const std::vector<glm::vec3>& points_m) const;

    const glm::dvec3& half_size_m() const { return half_m_; }
    /// Returns the observed patches of a side as text, row by row: 1 observed, 0 not.
    std::string format_patches(BoxSide side) const;
    /// Sets the observed patches of a side from the text of format_patches().
    /// @return false if the text has a wrong length or wrong characters
    bool parse_patches(BoxSide side, const std::string& text);

private:
    struct BoxSurfacePatch {
        BoxSide side;
        int column, row;
        auto operator<=>(const BoxSurfacePatch&) const = default;
    };
    glm::dvec3 half_m_;
    std::array<std::array<int, 2>, kBoxSides> n_{};  ///< number of patches of a side along its two axes
    std::array<std::vector<char>, kBoxSides> observed_patches_;

    /// Returns nothing if the point belongs to no patch.
    std::optional<BoxSurfacePatch> find_patch(const glm::dvec3& point_m) const;
    /// Returns the index of a patch in the array observed_patches_[patch.side].
    std::size_t index_of_patch(const BoxSurfacePatch& patch) const;
    BoxSurfacePatch mirror_patch(BoxSurfacePatch patch) const;
    /// Returns false if the patch is near the ground, where patches are ignored.
    bool is_above_ground(const BoxSurfacePatch& patch) const;
    bool is_patch_set(const BoxSurfacePatch& patch) const;
    double compute_area_fraction(std::optional<BoxSide> only_side, bool only_mirrored) const;
};

}  // namespace relidar
