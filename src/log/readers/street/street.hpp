// SPDX-License-Identifier: Apache-2.0
// The synthetic street as shapes, with exact ray casting. Street frame: x along the
// street, y to the left, z up, in metres. x = 0 is half-way through the log, the ground
// is z = 0.
#pragma once

#include <optional>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::street {

/// Appearance of a surface at the LiDAR's wavelength.
enum class Material { road, pavement, wall, metal, paint, leaves };

/// An upright box, or an upright cylinder with radius half.x and half height half.z.
struct Shape {
    enum class Kind { box, cylinder } kind = Kind::box;
    glm::dvec3 centre{0.0};
    glm::dvec3 half{0.0};
    double yaw_rad = 0.0;
    Material material = Material::wall;
    double reflectance = 0.5;  ///< reflectance from 0 to 1
};

/// A leg or an arm: a capsule that hangs from a joint and swings forward and backward,
/// once per stride.
struct Limb {
    glm::dvec3 joint_m{0.0};  ///< in the box frame
    double length_m = 0.0;    ///< length of the axis, from the joint
    double radius_m = 0.0;
    double swing_rad = 0.0;  ///< maximum angle from straight down
    double phase_rad = 0.0;  ///< phase of the stride at walked distance 0
    double reflectance = 0.5;
};

/// A car, pedestrian or cyclist that moves straight at constant speed, or along a track.
/// Its shapes are relative to the origin of the box frame.
struct MovingCar {
    const char* category = "Car";
    glm::dvec3 start_m{0.0};  ///< centre of the box at time 0
    double yaw_rad = 0.0;
    double speed_mps = 0.0;
    glm::dvec3 size_m{0.0};  ///< size of the box, slightly larger than the shapes
    std::vector<Shape> shapes;
    std::vector<Limb> limbs;
    double stride_m = 0.0;  ///< length of two steps
    PoseTrack track;        ///< in the street frame; if not empty, it replaces start, yaw and speed

    Pose world_from_box(double t_s) const;
    /// Returns the distance walked since the log began. The distance of a track begins
    /// with the distance of its first position from `start_m`. So a walker on the same
    /// path at another speed sets its feet at the same places.
    double walked_m(double t_s) const;
};

struct Street {
    std::vector<Shape> shapes;
    std::vector<MovingCar> cars;
};

/// Builds the street for some options. The seed determines the positions of facades,
/// poles, trees and parked cars.
Street make_street(const SyntheticOptions& options);

/// Returns the pose of the sensor in the street frame: it swings gently across the lane,
/// with the yaw along its path and a small pitch. Time 0 is frame 0.
Pose sensor_pose(const SyntheticOptions& options, double t_s);

/// Returns the reference time of a frame.
inline double frame_time_s(int frame) { return 0.1 * frame; }

struct Sphere {
    glm::dvec3 centre{0.0};
    double radius_m = 0.0;
};

struct Hit {
    double range_m;
    double cosine;  ///< cosine of the angle between ray and surface normal, 0..1
    double reflectance;
};

/// Positions of the moving cars at one time.
struct CarPlaces {
    std::optional<double> time_s;
    std::vector<glm::dvec3> centre_m;  ///< [cars] centres of their boxes
    std::vector<Pose> box_from_world;  ///< [cars] inverse poses of their boxes
};

/// Casts rays into a street.
class StreetCaster {
public:
    explicit StreetCaster(Street street);
    /// Returns the first surface along a ray at a time, at most max_range_m away.
    /// @param places  positions from an earlier ray of this caster, or empty; recomputed
    /// if the time differs
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m, CarPlaces& places) const;
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m) const;

private:
    /// A shape and precomputed values for ray casting.
    struct Solid {
        Shape shape;
        Sphere around;
        double cos_yaw, sin_yaw;
    };
    struct Car {
        MovingCar moving;
        std::vector<Solid> solids;
        /// distance from the centre of its box to the farthest point of its shapes
        double reach_m = 0.0;
    };
    /// Consecutive shapes that are close together, such as the leaves of a bush. Most
    /// rays miss the complete cluster.
    struct Cluster {
        Sphere around;
        std::size_t end;  ///< end of its shapes; the first shape is the end of the previous cluster
    };
    class Walk;
    std::vector<Solid> solids_;
    std::vector<Cluster> clusters_;
    std::vector<Car> cars_;

    static std::vector<Solid> solids_of(const std::vector<Shape>& shapes);
    void place_cars(double t_s, CarPlaces& places) const;
};

}  // namespace relidar::street
