// SPDX-License-Identifier: Apache-2.0
#include "blocks/way.hpp"

#include <nanoflann.hpp>

namespace relidar {

std::vector<glm::dvec3> frame_places(const Sequence& sequence) {
    std::vector<glm::dvec3> places;
    for (const Frame& frame : sequence.frames) places.push_back(sequence.world_from_vehicle.at(frame.time_s).translation);
    return places;
}

bool is_within(const BoxTrack& box, const Sequence& sequence, int position, double metres) {
    const double time_s = sequence.frames[std::size_t(position)].time_s;
    return box.present(time_s) &&
           glm::distance(box.world_from_box.at(time_s).translation, sequence.world_from_vehicle.at(time_s).translation) <= metres;
}

struct NearestPlace::Tree {
    struct Places {
        std::vector<glm::dvec3> m;
        std::size_t kdtree_get_point_count() const { return m.size(); }
        double kdtree_get_pt(std::size_t i, std::size_t axis) const { return m[i][static_cast<int>(axis)]; }
        template <class Box>
        bool kdtree_get_bbox(Box&) const { return false; }
    };
    Places places;
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Places>, Places, 3, std::size_t> index;

    explicit Tree(const std::vector<glm::dvec3>& m) : places{m}, index(3, places, nanoflann::KDTreeSingleIndexAdaptorParams(8)) {}
};

NearestPlace::NearestPlace(const std::vector<glm::dvec3>& places) : tree_(std::make_unique<Tree>(places)) {}
NearestPlace::~NearestPlace() = default;

std::size_t NearestPlace::of(const glm::vec3& point_m) const {
    const glm::dvec3 point(point_m);
    std::size_t nearest = 0;
    double distance2 = 0.0;
    tree_->index.knnSearch(&point.x, 1, &nearest, &distance2);
    return nearest;
}

}  // namespace relidar
