// SPDX-License-Identifier: Apache-2.0
// Shapes of the synthetic street, and exact ray casting. The street frame is in metres: x
// along the street, y left, z up. The middle of the sensor's path has x = 0. The ground
// has z = 0.
#pragma once

#include <optional>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::street {

/// Materials of surfaces, which differ in reflectance for the laser of a LiDAR.
enum class Material { road, pavement, wall, metal, paint, leaves };

/// An upright box or cylinder. A cylinder has the radius half.x and the height 2 half.z.
struct Shape {
    enum class Kind { box, cylinder } kind = Kind::box;
    glm::dvec3 centre{0.0};
    glm::dvec3 half{0.0};
    double yaw_rad = 0.0;
    Material material = Material::wall;
    double reflectance = 0.5;  ///< reflectance from 0 to 1
    SurfaceClass surface = SurfaceClass::building;
};

/// A leg or an arm of a walking person: a capsule that swings about its joint once per
/// stride.
struct Limb {
    glm::dvec3 joint_m{0.0};  ///< position of the joint in the frame of the person's box
    double length_m = 0.0;    ///< length of the capsule's axis, from the joint to the end
    double radius_m = 0.0;
    double swing_rad = 0.0;  ///< maximum angle from straight down
    double phase_rad = 0.0;  ///< phase of the swing at the start of the walk
    double reflectance = 0.5;
};

/// A moving car, pedestrian or cyclist. It moves straight at constant speed, or along a
/// track. Its shapes are in the frame of its box.
struct MovingCar {
    const char* category = "Car";
    glm::dvec3 start_m{0.0};  ///< centre of the box at time 0, in the street frame
    double yaw_rad = 0.0;
    double speed_mps = 0.0;
    glm::dvec3 size_m{0.0};  ///< size of the box, which is slightly larger than the shapes in it
    std::vector<Shape> shapes;
    std::vector<Limb> limbs;
    double stride_m = 0.0;  ///< length of a stride; a stride consists of two steps
    /// Poses in the street frame. A non-empty track replaces start, yaw and speed.
    PoseTrack track;

    Pose world_from_box(double t_s) const;
    /// Returns the distance that the person has walked at a time. It is 0 at time 0, or
    /// at `start_m` if the person follows a track. Therefore all persons on the same path
    /// step on the same places, even at different speeds.
    double compute_walked_m(double t_s) const;
};

struct Street {
    std::vector<Shape> shapes;
    std::vector<MovingCar> cars;
};

/// Creates the shapes of a synthetic street. The random seed in the options determines
/// the positions of facades, poles, trees and parked cars.
Street make_street(const SyntheticOptions& options);

/// Returns the pose of the sensor on its drive along the street. The sensor swings gently
/// across the lane, faces along its path, and has a small pitch. Frame 0 has the time 0.
Pose compute_sensor_pose(const SyntheticOptions& options, double t_s);

/// Returns the time of a frame in seconds. Frames are 0.1 s apart.
inline double compute_frame_time_s(int frame) { return 0.1 * frame; }

struct Sphere {
    glm::dvec3 centre{0.0};
    double radius_m = 0.0;
};

struct Hit {
    double range_m;
    double cosine;  ///< cosine of the angle between ray and surface normal, 0 to 1
    double reflectance;
    SurfaceClass surface;
};

/// Poses of all moving cars at one time. Consecutive rays with the same time reuse them.
struct CarPlaces {
    std::optional<double> time_s;
    std::vector<glm::dvec3> centre_m;  ///< [cars] centre of the box of each car
    std::vector<Pose> box_from_world;  ///< [cars] transform from the street frame to the box of each car
};

/// Casts rays into a street.
class StreetCaster {
public:
    explicit StreetCaster(Street street);
    /// Returns the first surface that a ray hits at a time, if it is nearer than
    /// max_range_m.
    /// @param places  cached poses of the cars, or empty; recomputed if their time
    /// differs from t_s
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m, CarPlaces& places) const;
    std::optional<Hit> cast(const WorldRay& ray, double t_s, double max_range_m) const;

private:
    /// A shape with precomputed values for faster ray casting.
    struct Solid {
        Shape shape;
        Sphere around;
        double cos_yaw, sin_yaw;
    };
    struct Car {
        MovingCar moving;
        std::vector<Solid> solids;
        /// radius of a sphere around the centre of the box that contains all shapes of
        /// the car
        double reach_m = 0.0;
    };
    /// A group of shapes that are close together, such as the leaves of a bush. They are
    /// skipped if a ray misses their bounding sphere.
    struct Cluster {
        Sphere around;
        /// index after the last shape; the first shape is the `end` of the previous
        /// cluster
        std::size_t end;
    };
    class Walk;
    std::vector<Solid> solids_;
    std::vector<Cluster> clusters_;
    std::vector<Car> cars_;

    static std::vector<Solid> make_solids(const std::vector<Shape>& shapes);
    void compute_car_poses(double t_s, CarPlaces& places) const;
};

}  // namespace relidar::street
