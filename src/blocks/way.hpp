// SPDX-License-Identifier: Apache-2.0
// Where a log's vehicle was at its sweeps, and which sweep is the nearest to a place.
#pragma once

#include <memory>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/sequence.hpp>

namespace relidar {

/// Positions of the vehicle at the frames of a log. @return [frames] world
std::vector<glm::dvec3> frame_places(const Sequence& sequence);

/// Whether a box is present at a frame, within so many metres of the vehicle.
bool is_within(const BoxTrack& box, const Sequence& sequence, int position, double metres);

/// Asks for the nearest of some places. For any thread.
class NearestPlace {
public:
    explicit NearestPlace(const std::vector<glm::dvec3>& places);
    ~NearestPlace();
    std::size_t of(const glm::vec3& point_m) const;

private:
    struct Tree;
    std::unique_ptr<const Tree> tree_;
};

}  // namespace relidar
