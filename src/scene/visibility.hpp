// SPDX-License-Identifier: Apache-2.0
// What each frame says about a point: seen (a return lies there), seen through (returns all around it lie well behind it), or
// nothing. Points that frames see through belong to something that moved without a label (docs/method.md section 6: better).
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include <relidar/sequence.hpp>

namespace relidar {

enum class Sight : char { nothing, seen, seen_through };

/// Range images of some frames. A point asks at most 64 of them, so that the cost of many points grows with their number alone: frames
/// whose sensor was within 40 m, or little farther than the nearest was, evenly spread in time. Images are made when points near them are
/// announced, so that a process that asks for a part of a log makes those of that part.
class Visibility {
public:
    /// Of a log that stays as it is.
    Visibility(const Sequence& sequence, const std::vector<int>& positions);

    /// Makes the images that some points ask; nothing may be asked of other points. @param points_m [points] vectors of 3, world
    template <class Points>
    void announce(const Points& points_m) {
        for (const auto& point_m : points_m) want(glm::dvec3(point_m));
        make_wanted();
    }

    struct Votes {
        int seen = 0;
        int seen_through = 0;
        /// Seen through by at least two frames, and by this share of those that see it.
        bool is_seen_through(double share) const { return seen_through >= 2 && double(seen_through) >= share * double(seen); }
    };
    /// @param point_m [3] world
    Votes votes(const glm::vec3& point_m) const;

    /// Views that a point asks, ascending. @param point_m [3] world @return indices into the positions given
    const std::vector<std::uint32_t>& views_near(const glm::dvec3& point_m) const;
    /// What one view says of a point, with a margin of decimetres. @param point_m [3] world
    Sight look(std::uint32_t view, const glm::dvec3& point_m) const;
    /// Whether a view has a return in the direction of a point that is as far away, to tolerance_m. @param point_m [3] world
    bool has_return_at(std::uint32_t view, const glm::dvec3& point_m, double tolerance_m) const;
    double time_s(std::uint32_t view) const { return views_[view].time_s; }

private:
    struct View {
        double time_s;
        int lidar;
        std::vector<Pose> sensor_from_world;   ///< one a sector of the sweep, when the head faces the middle of it; none: not made yet
        std::vector<float> range_m;            ///< [rows*columns] nearest return, 0 where there is none
    };
    /// A point as a view sees it: its range, and the returned ranges of the 3 x 3 pixels around it.
    struct Surroundings {
        double range_m = 0.0;
        float returned_m[9];
        int n = 0;
    };
    /// Views that a tile of the ground asks.
    struct Tile {
        std::vector<std::uint32_t> views;
        bool wanted = false;
    };
    const Sequence& sequence_;
    std::vector<RangeGrid> grids_;   ///< [lidars]
    std::vector<int> positions_;     ///< [views] in the log
    std::vector<View> views_;
    std::unordered_map<std::uint64_t, Tile> tiles_;
    std::vector<std::uint32_t> wanted_;   ///< views to be made; some twice

    void want(const glm::dvec3& point_m);
    void make_wanted();
    void make(View& view, const Frame& frame) const;
    void sort_by_tile();
    Surroundings around(const View& view, const glm::dvec3& point_m) const;
};

}  // namespace relidar
