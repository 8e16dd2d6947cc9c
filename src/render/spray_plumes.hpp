// SPDX-License-Identifier: Apache-2.0
// Spray behind vehicles on a wet road; private to render.
#pragma once

#include <optional>
#include <vector>

#include <relidar/render.hpp>

namespace relidar {

/// A cloud of drops behind a vehicle: a box that stands on the road and begins at the vehicle's rear. Extinction falls by exp(-x / reach).
struct Plume {
    glm::dvec3 rear_m{0.0};           ///< [3] on the road in the middle of the rear, dataset's world
    glm::dvec3 ahead{1.0, 0.0, 0.0};  ///< [3] where it drives, unit, level
    double width_m = 0.0, height_m = 0.0, length_m = 0.0;
    double alpha = 0.0;               ///< extinction at the rear, 1/m
    double reach_m = 1.0;

    /// The part of a ray in it; nothing where it passes by. @param direction  unit
    std::optional<SprayStretch> along(const glm::dvec3& origin_m, const glm::dvec3& direction) const;
};

/// What a vehicle of so much width and height leaves at a speed. Its tyres meet a fifth of its width of the water, of which a share of 0.1
/// min(1, (v / 30 m/s)^2) hangs in its wake as drops of diameters exp(-D / 0.1 mm): alpha = share 0.2 film / (height 0.1 mm). They fall
/// within 0.8 s: reach = 0.8 s v. All numbers are assumptions.
/// @param velocity  m/s, dataset's world @param film_mm  depth of the water on the road
Plume plume_behind(const glm::dvec3& rear_m, const glm::dvec3& velocity, double width_m, double height_m, double film_mm);

/// Of the actors that are there, drive, and are as wide as a car (1.2 m).
/// @param placed [instances] now @param before [instances] a moment earlier @param shown [instances]
std::vector<Plume> plumes_of(const Scene& layout, const std::vector<InstancePose>& placed, const std::vector<InstancePose>& before,
                             const std::vector<bool>& shown, const glm::dvec3& world_offset_m, double film_mm);

/// Of the sensor's own vehicle, taken to be 1.8 m wide, 1.5 m high, and to end 2.5 m behind the sensor. Nothing where the scan shows no
/// level ground. @param velocity  m/s, dataset's world
std::optional<Plume> own_plume(const RenderedScan& scan, const glm::dvec3& velocity, double film_mm);

/// @return [rays] the parts of each in plumes
std::vector<std::vector<SprayStretch>> spray_along(const RenderedScan& scan, const std::vector<Plume>& plumes);

}  // namespace relidar
