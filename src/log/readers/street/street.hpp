// SPDX-License-Identifier: Apache-2.0
// Shapes of the synthetic street, and exact ray casting against them. Street frame in
// metres: x along the street, y left, z up. x = 0 is the middle of the log's path, and
// the ground is z = 0.
#pragma once

#include <optional>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::street {

/// Surface materials, which look different at the LiDAR's wavelength.
enum class Material { road, pavement, wall, metal, paint, leaves };

/// An upright box, or an upright cylinder. A cylinder has the radius half.x and the
/// height 2 half.z.
struct Shape {
    enum class Kind { box, cylinder } kind = Kind::box;
    glm::dvec3 centre{0.0};
    glm::dvec3 half{0.0};
    double yaw_rad = 0.0;
    Material material = Material::wall;
    double reflectance = 0.5;  ///< reflectance from 0 to 1
};

/// A leg or an arm of a walking person. It is a capsule that hangs from a joint and
/// swings forward and backward once per stride.
struct Limb {
    glm::dvec3 joint_m{0.0};  ///< joint in the frame of the person's box
    double length_m = 0.0;    ///< length of the axis, from the joint
    double radius_m = 0.0;
    double swing_rad = 0.0;  ///< maximum angle from straight down
    double phase_rad = 0.0;  ///< phase of the swing before the person has walked
    double reflectance = 0.5;
};

/// A car, pedestrian or cyclist. It moves straight at constant speed, or along a track.
/// The shapes are given in the frame of its box.
struct MovingCar {
    const char* category = "Car";
    glm::dvec3 start_m{0.0};  ///< centre of the box at time 0
    double yaw_rad = 0.0;
    double speed_mps = 0.0;
    glm::dvec3 size_m{0.0};  ///< size of the box, slightly larger than the shapes
    std::vector<Shape> shapes;
    std::vector<Limb> limbs;
    double stride_m = 0.0;  ///< length of a stride, which is two steps
    /// Poses in the street frame. If the track is not empty, it replaces start, yaw and
    /// speed.
    PoseTrack track;

    Pose world_from_box(double t_s) const;
    /// Returns the distance that the person has walked since the start of the log. If
    /// there is a track, the count starts with the distance from `start_m` to the track's
    /// first position. So a person on the same path at another speed sets the feet at the
    /// same places.
    double walked_m(double t_s) const;
};

struct Street {
    std::vector<Shape> shapes;
    std::vector<MovingCar> cars;
};

/// Creates the shapes of the street from the options. The random seed determines the
/// positions of facades, poles, trees and parked cars.
Street make_street(const SyntheticOptions& options);

/// Returns the pose of the sensor in the street frame. The sensor swings gently across
/// its lane. It faces along its path and has a small pitch. Time 0 is the time of frame
/// 0.
Pose sensor_pose(const SyntheticOptions& options, double t_s);

/// Returns the reference time of a frame in seconds.
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

/// Poses of all moving cars at one time, stored so that consecutive rays can use them
/// again.
struct CarPlaces {
    std::optional<double> time_s;
    std::vector<glm::dvec3> centre_m;  ///< [cars] centre of each car's box
    std::vector<Pose> box_from_world;  ///< [cars] transform from the street to each car's box
};

/// Casts rays into a street.
class StreetCaster {
public:
    explicit StreetCaster(Street street);
    /// Returns the first surface that a ray hits at a time. Surfaces beyond max_range_m
    /// are ignored.
    /// @param places  poses of the cars from an earlier ray, or empty. They are
    /// recomputed if the time differs.
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m, CarPlaces& places) const;
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m) const;

private:
    /// A shape with values that are computed once, so that ray casting is faster.
    struct Solid {
        Shape shape;
        Sphere around;
        double cos_yaw, sin_yaw;
    };
    struct Car {
        MovingCar moving;
        std::vector<Solid> solids;
        /// distance from the centre of the car's box to the farthest point of its shapes
        double reach_m = 0.0;
    };
    /// Consecutive shapes that are close together, such as the leaves of a bush. A ray
    /// that misses the bounding sphere is not tested against the shapes.
    struct Cluster {
        Sphere around;
        std::size_t end;  ///< index after the last shape; the first shape follows the previous cluster
    };
    class Walk;
    std::vector<Solid> solids_;
    std::vector<Cluster> clusters_;
    std::vector<Car> cars_;

    static std::vector<Solid> solids_of(const std::vector<Shape>& shapes);
    void place_cars(double t_s, CarPlaces& places) const;
};

}  // namespace relidar::street
