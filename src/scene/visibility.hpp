// SPDX-License-Identifier: Apache-2.0
// What each frame says about a point: seen (a return lies there), seen through (returns all around it lie well behind it), or
// nothing. Points that frames see through belong to something that moved without a label (docs/method.md section 6: better).
#pragma once

#include <vector>

#include <relidar/sequence.hpp>

namespace relidar {

/// Range images of some frames, with the nearest and farthest range of each pixel's neighbourhood.
class Visibility {
public:
    Visibility(const Sequence& sequence, const std::vector<int>& positions);

    struct Votes {
        int seen = 0;
        int seen_through = 0;
        /// Seen through by at least two frames, and by this share of those that see it.
        bool is_seen_through(double share) const { return seen_through >= 2 && double(seen_through) >= share * double(seen); }
    };
    /// @param point_m [3] world
    Votes votes(const glm::vec3& point_m) const;

private:
    struct View {
        double time_s;
        std::vector<float> nearest_m, farthest_m;   ///< [rows*columns] over 3 x 3 pixels, 0 where fewer than 3 of them returned
    };
    const Sequence& sequence_;
    RangeGrid grid_;
    std::vector<View> views_;

    glm::dvec3 in_sensor(const View& view, const glm::dvec3& point_m) const;
};

}  // namespace relidar
