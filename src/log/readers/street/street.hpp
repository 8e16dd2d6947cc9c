// SPDX-License-Identifier: Apache-2.0
// The synthetic street as shapes, and exact ray casting against them. Street frame: x
// along the street, y to the left, z up, metres; x = 0 half-way through the log, ground
// at z = 0.
#pragma once

#include <optional>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::street {

/// What a surface looks like at the LiDAR's wavelength.
enum class Material { road, pavement, wall, metal, paint, leaves };

/// An upright box, or an upright cylinder with radius half.x and half height half.z.
struct Shape {
    enum class Kind { box, cylinder } kind = Kind::box;
    glm::dvec3 centre{0.0};
    glm::dvec3 half{0.0};
    double yaw_rad = 0.0;
    Material material = Material::wall;
    double reflectance = 0.5;  ///< 0..1
};

/// A leg or an arm: a capsule that hangs from a joint and swings forward and backward,
/// once in a stride.
struct Limb {
    glm::dvec3 joint_m{0.0};  ///< box frame
    double length_m = 0.0;    ///< of its axis, from the joint on
    double radius_m = 0.0;
    double swing_rad = 0.0;  ///< from straight down, at most
    double phase_rad = 0.0;  ///< of the stride, when the walker has come 0 m
    double reflectance = 0.5;
};

/// A car, or someone on foot or on a bicycle, straight on at constant speed, or along a
/// track; its shapes lie about the origin of the box frame.
struct MovingCar {
    const char* category = "Car";
    glm::dvec3 start_m{0.0};  ///< centre of its box at time 0
    double yaw_rad = 0.0;
    double speed_mps = 0.0;
    glm::dvec3 size_m{0.0};  ///< of its box, a little larger than the shapes
    std::vector<Shape> shapes;
    std::vector<Limb> limbs;
    double stride_m = 0.0;  ///< two steps
    PoseTrack track;        ///< street frame; where it is not empty, it stands in for start, yaw and speed

    Pose world_from_box(double t_s) const;
    /// How far it has come since the log began. A track begins as far as its first place
    /// is ahead of `start_m`: who walks the same way at another speed sets his feet where
    /// he did.
    double walked_m(double t_s) const;
};

struct Street {
    std::vector<Shape> shapes;
    std::vector<MovingCar> cars;
};

/// Builds the street of some options: the seed places facades, poles, trees and parked
/// cars.
Street make_street(const SyntheticOptions& options);

/// Pose of the sensor, street frame: a gentle swing across the lane, yaw along it, small
/// pitch. Time 0 is frame 0.
Pose sensor_pose(const SyntheticOptions& options, double t_s);

/// Reference time of a frame.
inline double frame_time_s(int frame) { return 0.1 * frame; }

struct Sphere {
    glm::dvec3 centre{0.0};
    double radius_m = 0.0;
};

struct Hit {
    double range_m;
    double cosine;  ///< of the angle between ray and surface normal, 0..1
    double reflectance;
};

/// Where the cars of a street are at a moment.
struct CarPlaces {
    std::optional<double> time_s;
    std::vector<glm::dvec3> centre_m;  ///< [cars] of their boxes
    std::vector<Pose> box_from_world;  ///< [cars]
};

/// Casts rays into a street.
class StreetCaster {
public:
    explicit StreetCaster(Street street);
    /// First surface along a ray at a moment, at most max_range_m away.
    /// @param places  what an earlier ray of this caster left, or empty; found anew where
    /// that ray had another moment
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m, CarPlaces& places) const;
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m) const;

private:
    /// A shape with what each ray asks of it.
    struct Solid {
        Shape shape;
        Sphere around;
        double cos_yaw, sin_yaw;
    };
    struct Car {
        MovingCar moving;
        std::vector<Solid> solids;
        double reach_m = 0.0;  ///< from the centre of its box to the farthest of its shapes
    };
    /// Neighbours in the list of shapes that lie close together, such as the leaves of a
    /// bush: most rays pass them all by.
    struct Cluster {
        Sphere around;
        std::size_t end;  ///< of its shapes; the first is the end of the cluster before
    };
    class Walk;
    std::vector<Solid> solids_;
    std::vector<Cluster> clusters_;
    std::vector<Car> cars_;

    static std::vector<Solid> solids_of(const std::vector<Shape>& shapes);
    void place_cars(double t_s, CarPlaces& places) const;
};

}  // namespace relidar::street
