// SPDX-License-Identifier: Apache-2.0
// Surface of an actor's box. Stores which parts of the surface the log has observed.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// Sides of a box for which the observed fraction is measured. The bottom is excluded.
enum class BoxSide { front, rear, left, right, top };
inline constexpr std::size_t kBoxSides = 5;
/// Returns the name of a side: "front", "rear", "left", "right", "top".
const char* get_name(BoxSide side);

/// Axes of a side of a box. `normal` and `sign` define the outward normal. Patches are
/// counted along the axes `first` and `second`. For vertical sides, `second` is the
/// height.
struct SideFrame {
    int normal;
    double sign;
    int first, second;
};
inline constexpr SideFrame kSideFrames[kBoxSides] = {
    {0, 1.0, 1, 2}, {0, -1.0, 1, 2}, {1, 1.0, 0, 2}, {1, -1.0, 0, 2}, {2, 1.0, 1, 0}};

/// Observed fraction of each side of a box, 0 to 1. The order is that of the enumerators
/// of BoxSide.
using SideShares = std::array<float, kBoxSides>;
/// Minimum observed fraction of a side. If the log observed less, the side counts as
/// unseen.
inline constexpr float kUnseenSide = 0.1f;
/// Returns the names of the unseen sides, for example "rear, left". Returns an empty text
/// if the log observed all sides.
std::string list_unseen_sides(const SideShares& shares);
/// Returns the minimum cosine between a ray and the normal of a side. A ray at a smaller
/// cosine does not observe the side, because such returns form separate streaks. The
/// limit of the top is lower, because a LiDAR on a car hits the roofs of other cars only
/// at grazing angles.
double least_cosine(BoxSide side);

/// Surface of a box, divided into patches of about 0.3 m. The class stores which patches
/// were observed by rays. A point belongs to the patch onto which it projects from the
/// centre of the box. The lowest fifth of the four sides is ignored, because it is hidden
/// near the ground. Every patch has a mirror patch on the other side of the x-z plane.
class BoxSurface {
public:
    /// Creates a surface without observed patches.
    /// @param size_m [3] length, width, height, all above 0
    explicit BoxSurface(const glm::dvec3& size_m);
    /// Marks the patch of a point as observed by a ray. The ray must hit the side from
    /// outside and must not graze it. Rays from inside are ignored, because they have
    /// passed through a window to the far side. The centre of the box and points below
    /// the sides are ignored too.
    /// @param point_m [3] box frame
    /// @param direction [3] direction of the ray, box frame
    void add(const glm::dvec3& point_m, const glm::dvec3& direction);
    /// Returns true if the patch of a point was observed. Returns false if the point is
    /// on the ignored lowest part of a side.
    bool is_seen(const glm::dvec3& point_m) const;
    /// Returns true if the patch of a point was not observed, but its mirror patch on the
    /// other side of the box was observed.
    bool is_mirrored(const glm::dvec3& point_m) const;
    /// Returns the observed fraction of a side, 0 to 1.
    double seen(BoxSide side) const;
    /// Returns the observed fraction of the complete box surface, by area, 0 to 1.
    /// mirrored() returns the fraction of patches that were not observed themselves, but
    /// whose mirror patch was observed.
    double seen() const;
    double mirrored() const;
    /// Returns the fraction of a side's patches that were not observed, but whose mirror
    /// images on the other half of the box were observed.
    double mirrored(BoxSide side) const;

    /// If true, the model has mirrored surfels on the patches that were not observed but
    /// whose mirror patches were observed. These patches are called completed.
    bool is_completed = false;
    /// Returns the fraction of each side that is observed or completed.
    SideShares known() const;
    /// Returns the side of a point on a completed patch. Returns no value if the point is
    /// on a different patch.
    std::optional<BoxSide> completed_side(const glm::dvec3& point_m) const;
    /// Compares observed patches with their observed mirror patches.
    /// @param points_m points of the surface, box frame
    /// @return median difference between the mean distances of their points from the
    /// plane through the box centre, metres. 0 if fewer than three pairs were observed.
    double asymmetry_m(const std::vector<glm::vec3>& points_m) const;

    const glm::dvec3& half_size_m() const { return half_m_; }
    /// Returns the patches of a side as a text, row by row: 1 was observed, 0 was not.
    std::string patches(BoxSide side) const;
    /// Sets the patches of a side.
    /// @return false if the text has a wrong length or wrong characters
    bool set_patches(BoxSide side, const std::string& text);

private:
    struct Patch {
        BoxSide side;
        int column, row;
    };
    glm::dvec3 half_m_;
    std::array<std::array<int, 2>, kBoxSides> n_{};  ///< number of patches of a side along its two axes
    std::array<std::vector<char>, kBoxSides> seen_;

    /// Returns the patch of a point. Returns no value if the point belongs to no patch.
    std::optional<Patch> find(const glm::dvec3& point_m) const;
    Patch mirror(Patch patch) const;  ///< returns the mirror patch
    /// Returns true if the patch is above the ignored part near the ground.
    bool counts(const Patch& patch) const;
    bool at(const Patch& patch) const;  ///< returns true if the patch was observed
    /// Returns two areas in m2: the area of the observed (or mirrored) patches, and the
    /// area of all patches.
    std::array<double, 2> areas(BoxSide side, bool mirrored) const;
    /// Returns the observed (or mirrored) fraction of the area of all sides.
    double share(bool mirrored) const;
};

}  // namespace relidar
