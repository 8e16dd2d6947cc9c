// SPDX-License-Identifier: Apache-2.0
// Shapes of the synthetic street, exact ray casting, and the two returns that a receiver
// reports for a conical beam. The street frame is in metres: x along the street, y left,
// z up. The middle of the sensor's path has x = 0. The ground has z = 0.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include <relidar/read/dataset.hpp>

namespace relidar::street {

/// upright; a cylinder has the radius half.x and the height 2 half.z
struct StreetShape {
    enum class Kind { box, cylinder } kind = Kind::box;
    glm::dvec3 centre{0.0};
    glm::dvec3 half{0.0};
    double yaw_rad = 0.0;
    bool has_windows = false;  ///< of dark glass, in walls
    double reflectance = 0.5;  ///< reflectance from 0 to 1
    SurfaceClass surface = SurfaceClass::building;
};

/// a capsule that swings about its joint once per stride
struct SwingingLimb {
    glm::dvec3 joint_m{0.0};  ///< position of the joint in the frame of the person's box
    double length_m = 0.0;    ///< length of the capsule's axis, from the joint to the end
    double radius_m = 0.0;
    double swing_rad = 0.0;  ///< maximum angle from straight down
    double phase_rad = 0.0;  ///< phase of the swing at the start of the walk
    double reflectance = 0.5;
};

/// Moves straight at constant speed, or along a track. Its shapes are in the frame of its
/// box.
struct MovingStreetActor {
    const char* category = "Car";
    glm::dvec3 start_m{0.0};  ///< centre of the box at time 0, in the street frame
    double yaw_rad = 0.0;
    double speed_mps = 0.0;
    glm::dvec3 size_m{0.0};  ///< size of the box, which is slightly larger than the shapes in it
    std::vector<StreetShape> shapes;
    std::vector<SwingingLimb> limbs;
    double stride_m = 0.0;  ///< length of a stride; a stride consists of two steps
    /// poses of the box in street coordinates; empty: straight at constant speed
    PoseTrack track;

    Pose world_from_box_at(double time_s) const;
    /// Returns the distance in metres that a person has walked until `time_s`. It
    /// controls the swing of arms and legs. Without a `track`, it is 0 at time 0. With a
    /// `track`, its value at the first pose is the distance from start_m to this pose
    /// along yaw_rad.
    double walked_m(double time_s) const;
};

struct SyntheticStreet {
    std::vector<StreetShape> shapes;
    std::vector<MovingStreetActor> cars;
};

/// Creates the shapes of a synthetic street. The random seed in the options determines
/// the positions of facades, poles, trees and parked cars.
SyntheticStreet make_street(const StreetOptions& options);

/// Returns the pose of the sensor on its drive along the street. The sensor swings gently
/// across the lane, faces along its path, and has a small pitch. Frame 0 has the time 0.
Pose sensor_pose_at(const StreetOptions& options, double time_s);

/// 0.1 s apart; frame 0 has the time 0
inline double frame_time_of_s(int frame_number) { return 0.1 * frame_number; }

struct Sphere {
    glm::dvec3 centre{0.0};
    double radius_m = 0.0;
};

struct StreetHit {
    double range_m;
    double cosine;  ///< cosine of the angle between ray and surface normal, 0 to 1
    double reflectance;
    SurfaceClass surface;
};

/// poses of all moving cars at one time, reused for consecutive rays
struct ActorPoses {
    std::optional<double> time_s;
    std::vector<glm::dvec3> centre_m;  ///< [cars] centre of the box of each car
    std::vector<Pose> box_from_world;  ///< [cars] transform from the street frame to the box of each car
};

class StreetCaster {
public:
    explicit StreetCaster(SyntheticStreet street);
    /// Returns the first surface that a ray hits at a time, within max_range_m.
    /// @param actor_poses  cache of the poses of cars and people, for one time
    std::optional<StreetHit> find_first_hit(const WorldRay& ray, double time_s, double max_range_m,
                                            ActorPoses& actor_poses) const;

private:
    /// with precomputed values
    struct RayCastShape {
        StreetShape shape;
        Sphere around;
        double cos_yaw, sin_yaw;
    };
    struct RayCastActor {
        MovingStreetActor moving;
        std::vector<RayCastShape> solids;
        /// radius of a sphere around the centre of the box
        double reach_m = 0.0;
    };
    /// Shapes that are close together. A ray that misses their bounding sphere skips
    /// them.
    struct Cluster {
        Sphere around;
        std::vector<RayCastShape> solids;
    };
    class NearestSurfaceSearch;
    std::vector<Cluster> clusters_;
    std::vector<RayCastActor> actors_;

    /// Adds a moving actor. Sets the class of its surfaces and its bounding sphere.
    void add_actor(MovingStreetActor moving);
    static std::vector<RayCastShape> prepare_shapes(std::span<const StreetShape> shapes);
    void place_actors(double time_s, ActorPoses& actor_poses) const;
};

inline constexpr int kConeRays = 53;  ///< number of thin rays that represent the cone of a beam

/// Replaces each ray by kConeRays thin rays, which form a spiral in its cone (the
/// divergence).
RayTable make_cone_rays(const RayTable& rays);

/// Computes two returns per ray, as a receiver does, from the hits in the beam's cone.
/// - If at most half of the thin rays have hits, the ray is dropped.
/// - Hits whose ranges differ by less than 0.5 m from the next hit form one return, at
///   their mean range, weighted by light.
/// - The first return is the strongest one. The second is the last one, or the next
///   strongest one if the strongest is the last, if it is bright enough to be detected.
/// @param scan_of_cone_rays  scan with the hits of the rays from make_cone_rays(rays)
Scan combine_cone(const RayTable& rays, const Scan& scan_of_cone_rays, double max_range_m);

}  // namespace relidar::street

namespace relidar {

/// Generates the frames [begin_frame, end_frame) of the log that make_street_log()
/// generates.
Log make_frames(const StreetOptions& options, int begin_frame, int end_frame);

}  // namespace relidar
