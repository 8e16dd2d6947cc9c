// SPDX-License-Identifier: Apache-2.0
// Mirrors surfels at the x-z plane of a box.
#include <relidar/scene/labels.hpp>
#include <relidar/scene/symmetry.hpp>

namespace relidar {
namespace {

// Maximum distance between the left and the mirrored right surface of a symmetric object.
// The middle of a too large box is not exactly its symmetry plane.
constexpr double kMostAsymmetry_m = 0.15;
/// indices of the spherical harmonics that are odd in y (negative order)
constexpr int kOddInY[] = {1, 4, 5, 9, 10, 11};

}  // namespace

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
    // surfels with an opacity above 0.5
    std::vector<glm::vec3> opaque_m;
    for (std::size_t i = 0; i < surfels.size(); ++i)
        if (surfels.opacity_logit[i] > 0.0f) opaque_m.push_back(surfels.mean[i]);
    if (surface.asymmetry_m(opaque_m) > kMostAsymmetry_m) return 0;
    std::vector<std::uint32_t> remaining, copied;
    for (std::uint32_t i = 0; i < surfels.size(); ++i) {
        const glm::dvec3 here(surfels.mean[i]), there(here.x, -here.y, here.z);
        // A mirrored surfel replaces this one if only the mirror patch was observed.
        if (!surface.is_mirror_observed(here)) remaining.push_back(i);
        // The mirror image of this surfel would fill an unobserved patch.
        if (surface.is_mirror_observed(there)) copied.push_back(i);
    }
    if (copied.empty()) return 0;
    const Surfels mirrored_surfels = mirror_surfels(surfels.reorder(copied));
    surfels = surfels.reorder(remaining);
    surfels.append_surfels(mirrored_surfels);
    surface.is_completed = true;
    return copied.size();
}

}  // namespace relidar
