// SPDX-License-Identifier: Apache-2.0
// Surface of an actor's box. Stores which parts of the surface the log has observed.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// Sides of the box of an actor. For each side, relidar measures the fraction that LiDAR
/// rays have observed. The bottom is left out.
enum class BoxSide { front, rear, left, right, top };
inline constexpr std::size_t kBoxSides = 5;
/// Returns the name of a side: "front", "rear", "left", "right", "top".
const char* get_name(BoxSide side);

/// Axes of a side of a box. The outward normal is axis `normal` with the sign `sign`. The
/// side is divided into patches along the axes `first` and `second`. On vertical sides,
/// `second` is the height.
struct BoxSideAxes {
    int normal;
    double sign;
    int first, second;
};
inline constexpr BoxSideAxes kSideFrames[kBoxSides] = {
    {0, 1.0, 1, 2}, {0, -1.0, 1, 2}, {1, 1.0, 0, 2}, {1, -1.0, 0, 2}, {2, 1.0, 1, 0}};

/// Observed fraction of each side of a box, 0 to 1, in the order of the enumeration
/// BoxSide.
using ObservedSideFractions = std::array<float, kBoxSides>;
/// Minimum observed fraction of a side of a box. A side below this fraction counts as
/// unseen.
inline constexpr float kUnseenSide = 0.1f;
/// Returns the names of the unseen sides, for example "rear, left". Returns an empty text
/// if the log observed all sides.
std::string format_unobserved_sides(const ObservedSideFractions& observed_fractions);
/// Returns the minimum cosine between a ray and the normal of a side. Rays at a more
/// grazing angle do not count as observations, because their returns form separate
/// streaks. The limit of the top is lower, because a LiDAR on a car hits other roofs only
/// at grazing angles.
double get_min_incidence_cosine(BoxSide side);

/// Surface of a box, divided into patches of about 0.3 m. The class stores which patches
/// were observed by rays. A point belongs to the patch onto which it projects from the
/// centre of the box. The lowest fifth of the four sides is ignored, because it is hidden
/// near the ground. Every patch has a mirror patch on the other side of the x-z plane.
class ObservedBoxSurface {
public:
    /// Divides a box surface into patches, none of which is observed yet.
    /// @param size_m [3] length, width, height, all above 0
    explicit ObservedBoxSurface(const glm::dvec3& size_m);
    bool operator==(const ObservedBoxSurface&) const = default;
    /// Marks the patch of a point as observed by a ray. The ray must hit the side from
    /// outside and must not graze it. Rays from inside are ignored, because they have
    /// passed through a window to the far side. The centre of the box and points below
    /// the sides are ignored too.
    /// @param point_m [3] box frame
    /// @param ray_direction [3] direction of the ray, box frame
    void mark_patch_of_point_as_observed(const glm::dvec3& point_m, const glm::dvec3& ray_direction);
    /// Returns true if a ray has observed the part of the box surface (patch of about 0.3
    /// m) that contains a point. Always returns false in the lowest fifth of the four
    /// sides, because it is hidden near the ground.
    bool is_patch_of_point_observed(const glm::dvec3& point_m) const;
    /// Returns true if the patch of a point was not observed, but its mirror patch on the
    /// other half of the box was.
    bool is_observed_only_in_mirror_image(const glm::dvec3& point_m) const;
    /// Returns the observed fraction, by area, of a side or of the complete surface, 0 to 1.
    double compute_observed_area_fraction(std::optional<BoxSide> side = {}) const;
    /// Returns the fraction that was not observed, but whose mirror image was.
    double compute_mirrorable_area_fraction(std::optional<BoxSide> side = {}) const;

    /// If true, unobserved patches of the model were completed: they got mirrored surfels
    /// if their mirror patches were observed.
    bool is_completed = false;
    /// Returns the observed fraction of each side of the box. If `is_completed` is true,
    /// also counts unobserved patches that were filled with mirrored surfels of the other
    /// half.
    ObservedSideFractions compute_covered_fraction_of_each_side() const;
    /// Parts (patches) of the box surface that no ray observed can be filled with surfels
    /// mirrored from the other half of the box. If the point is in such a patch, returns
    /// the side of the box. Otherwise returns nothing.
    std::optional<BoxSide> find_box_side_with_mirrored_surfels(const glm::dvec3& point_m) const;
    /// Measures how much the left and right half of an object differ. Compares each patch
    /// with its mirror patch on the other half if both were observed.
    /// @param points_m points of the surface, box frame
    /// @return median difference between the two patches of a pair, metres. A patch
    /// counts with the mean distance of its points from the box centre along the normal
    /// of its side. 0 with fewer than three pairs
    double compute_left_right_asymmetry_m(const std::vector<glm::vec3>& points_m) const;

    const glm::dvec3& half_size_m() const { return half_m_; }
    /// Returns the observed patches of a side as text, row by row. 1 means observed, 0
    /// not observed.
    std::string format_observed_patches(BoxSide side) const;
    /// Sets the observed patches of a side from the text that format_observed_patches()
    /// returns.
    /// @return false if the text has a wrong length or wrong characters
    bool try_parse_and_set_observed_patches(BoxSide side, const std::string& text);

private:
    struct BoxSurfacePatch {
        BoxSide side;
        int column, row;
    };
    glm::dvec3 half_m_;
    std::array<std::array<int, 2>, kBoxSides> n_{};  ///< number of patches of a side along its two axes
    std::array<std::vector<char>, kBoxSides> observed_patches_;

    /// Returns nothing if the point belongs to no patch.
    std::optional<BoxSurfacePatch> find_patch_of_point(const glm::dvec3& point_m) const;
    /// Returns the index of a patch in the array observed_patches_[patch.side].
    std::size_t get_patch_index(const BoxSurfacePatch& patch) const;
    BoxSurfacePatch get_mirror_patch(BoxSurfacePatch patch) const;
    /// Returns false if the patch is near the ground, where patches are ignored.
    bool is_patch_above_ground_margin(const BoxSurfacePatch& patch) const;
    bool has_observed_patch(const BoxSurfacePatch& patch) const;
    double compute_area_fraction(std::optional<BoxSide> only_side, bool only_mirror_image_observed) const;
};

}  // namespace relidar
