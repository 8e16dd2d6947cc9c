// SPDX-License-Identifier: Apache-2.0
// Intersects rays exactly with the shapes of the synthetic street: the ground plane,
// upright boxes (slab test), and upright cylinders with caps (quadratic equation in the
// plane). For a ray o + t d:
//   box: t_axis = (+-half - o) / d;   cylinder: |o_xy + t d_xy| = r, |z| <= half height
#include "read/datasets/street/street.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>
#include <utility>

#include "base/geometry/ray_box.hpp"

namespace relidar::street {
namespace {

/// Point origin + t * direction at which a ray enters a shape. No hit: t is infinite.
struct ShapeHit {
    double t = std::numeric_limits<double>::infinity();
    glm::dvec3 normal{0.0};
};

/// Intersects a ray with a box around the origin. A ray from inside has no hit.
/// @param half_size  half of the edge lengths
ShapeHit intersect_box(const glm::dvec3& half_size, const glm::dvec3& origin, const glm::dvec3& direction) {
    const auto inside = cross_box(origin, direction, -half_size, half_size);
    if (!inside || !(inside->enter > 0.0)) return {};
    ShapeHit hit{inside->enter, glm::dvec3(0.0)};
    hit.normal[inside->axis] = -std::copysign(1.0, direction[inside->axis]);
    return hit;
}

/// Returns the t at which a ray enters the infinite cylinder around the z axis, or
/// nothing if it misses. Solves |o + t d| = radius in x and y, which is a t^2 + 2 b t + c
/// = 0.
std::optional<double> enter_tube(double radius, const glm::dvec3& o, const glm::dvec3& d) {
    const double a = d.x * d.x + d.y * d.y, b = o.x * d.x + o.y * d.y,
                 c = o.x * o.x + o.y * o.y - radius * radius;
    const double discriminant = b * b - a * c;
    if (!(a > 0.0 && discriminant >= 0.0)) return {};
    return (-b - std::sqrt(discriminant)) / a;
}

/// Intersects a ray with an upright cylinder around the origin. Tests the curved side
/// first and then the cap that faces the ray.
ShapeHit intersect_cylinder(double radius, double half_height, const glm::dvec3& ray_origin,
                            const glm::dvec3& ray_direction) {
    ShapeHit best;
    if (const auto t = enter_tube(radius, ray_origin, ray_direction)) {
        const glm::dvec3 p = ray_origin + *t * ray_direction;
        if (*t > 0.0 && std::abs(p.z) <= half_height) best = {*t, glm::dvec3(p.x, p.y, 0.0) / radius};
    }
    if (ray_direction.z != 0.0) {
        const double cap_z = -std::copysign(half_height, ray_direction.z),
                     t = (cap_z - ray_origin.z) / ray_direction.z;
        const glm::dvec3 p = ray_origin + t * ray_direction;
        if (t > 0.0 && t < best.t && p.x * p.x + p.y * p.y <= radius * radius)
            best = {t, {0.0, 0.0, std::copysign(1.0, cap_z)}};
    }
    return best;
}

/// Intersects a ray with a capsule, whose axis points down from the origin. Tests the
/// curved side and both end spheres, and keeps the first hit.
/// @param ray_direction  unit vector
ShapeHit intersect_capsule(double radius, double length, const glm::dvec3& ray_origin,
                           const glm::dvec3& ray_direction) {
    ShapeHit best;
    // The normal points from (0, 0, axis_z), the nearest point of the axis, to the hit.
    const auto keep_if_nearer = [&](double t, double axis_z) {
        if (t > 0.0 && t < best.t)
            best = {t, (ray_origin + t * ray_direction - glm::dvec3(0.0, 0.0, axis_z)) / radius};
    };
    if (const auto t = enter_tube(radius, ray_origin, ray_direction)) {
        const double z = ray_origin.z + *t * ray_direction.z;
        if (z <= 0.0 && z >= -length) keep_if_nearer(*t, z);
    }
    for (const double end_z : {0.0, -length}) {
        const glm::dvec3 from_centre = ray_origin - glm::dvec3(0.0, 0.0, end_z);
        const double b = glm::dot(from_centre, ray_direction),
                     discriminant = b * b - glm::dot(from_centre, from_centre) + radius * radius;
        if (discriminant >= 0.0) keep_if_nearer(-b - std::sqrt(discriminant), end_z);
    }
    return best;
}

glm::dvec3 rotate_about_z(const glm::dvec3& vector, double cosine, double sine) {
    return {cosine * vector.x - sine * vector.y, sine * vector.x + cosine * vector.y, vector.z};
}

/// Returns true if a point of a wall is on a window. Walls that face the y direction have
/// windows of dark glass, 1.2 m wide and 1.5 m high, every 3 m in both directions.
bool is_window(const StreetShape& wall, const glm::dvec3& local_point, const glm::dvec3& local_normal) {
    if (std::abs(local_normal.y) < 0.5) return false;
    // distances from the end of the wall and from its bottom, in metres
    const double u = local_point.x + wall.half.x, v = local_point.z + wall.half.z;
    return u - 3.0 * std::floor(u / 3.0) < 1.2 && v > 1.0 && v - 3.0 * std::floor(v / 3.0) > 1.5;
}

/// Returns the bounding sphere of a shape, through the corners of its box.
Sphere bounding_sphere(const StreetShape& shape) { return {shape.centre, glm::length(shape.half)}; }

/// Returns a sphere that contains several shapes. Its centre is the centre of the box
/// around the centres of the shapes.
Sphere bounding_sphere(std::span<const StreetShape> shapes) {
    glm::dvec3 low = shapes.front().centre, high = low;
    for (const StreetShape& shape : shapes) {
        low = glm::min(low, shape.centre);
        high = glm::max(high, shape.centre);
    }
    Sphere around{0.5 * (low + high)};
    for (const StreetShape& shape : shapes) {
        const Sphere s = bounding_sphere(shape);
        around.radius_m = std::max(around.radius_m, glm::distance(around.centre, s.centre) + s.radius_m);
    }
    return around;
}

}  // namespace

/// Finds the nearest surface on a ray. The caller passes all shapes, one after another.
class StreetCaster::NearestSurfaceSearch {
public:
    NearestSurfaceSearch(const WorldRay& ray, double max_range_m) : ray_(ray), nearest_m_(max_range_m) {}

    /// Returns true if the shapes inside a sphere need no test, because the ray misses
    /// the sphere or has already hit a nearer surface.
    bool can_skip_sphere(const Sphere& sphere, const glm::dvec3& origin, const glm::dvec3& direction) const {
        const glm::dvec3 to = sphere.centre - origin;  // `along`: its part along the ray
        const double along = glm::dot(to, direction), radius2 = sphere.radius_m * sphere.radius_m;
        if (glm::dot(to, to) - along * along > radius2) return true;
        return along < -sphere.radius_m || along - sphere.radius_m > nearest_m_;
    }

    /// Intersects the ray with the ground: a road with a dashed centre line, and
    /// pavements on both sides. Stores the hit if it is the nearest so far.
    void hit_ground() {
        if (!(ray_.direction.z < 0.0)) return;
        const double t = -ray_.origin_m.z / ray_.direction.z;
        if (!(t > 0.0) || t > nearest_m_) return;
        nearest_m_ = t;
        const glm::dvec3 point = ray_.origin_m + t * ray_.direction;
        // The road is 8.4 m wide and its middle is at y = 1.7 m. The dashes of the centre
        // line are 3 m long and repeat every 6 m.
        const double middle = std::abs(point.y - 1.7), cosine = -ray_.direction.z;
        const bool dash = middle < 0.08 && point.x - 6.0 * std::floor(point.x / 6.0) < 3.0;
        if (middle < 4.2) hit_ = StreetHit{t, cosine, dash ? 0.8 : 0.18, SurfaceClass::road};
        else hit_ = StreetHit{t, cosine, 0.32, SurfaceClass::sidewalk};
    }

    /// Intersects the ray with a shape. Stores the hit if it is the nearest so far.
    /// @param ray_origin,ray_direction  ray in the frame in which the pose of the shape
    /// is given
    void hit_solid(const RayCastShape& solid, const glm::dvec3& ray_origin, const glm::dvec3& ray_direction) {
        if (can_skip_sphere(solid.around, ray_origin, ray_direction)) return;
        const StreetShape& shape = solid.shape;
        // Rotates the ray into the frame of the shape, in which the shape is
        // axis-aligned.
        const double c = solid.cos_yaw, s = -solid.sin_yaw;
        const glm::dvec3 o = rotate_about_z(ray_origin - shape.centre, c, s),
                         d = rotate_about_z(ray_direction, c, s);
        const ShapeHit m = shape.kind == StreetShape::Kind::box
                               ? intersect_box(shape.half, o, d)
                               : intersect_cylinder(shape.half.x, shape.half.z, o, d);
        if (!(m.t <= nearest_m_)) return;
        nearest_m_ = m.t;
        const bool glass = shape.has_windows && is_window(shape, o + m.t * d, m.normal);
        hit_ =
            StreetHit{m.t, std::abs(glm::dot(m.normal, d)), glass ? 0.06 : shape.reflectance, shape.surface};
    }

    /// Intersects the ray with an arm or a leg. Stores the hit if it is the nearest.
    /// @param pitch_rad  swing angle of the limb, from straight down to the front
    /// @param ray_origin,ray_direction  ray in the frame of the box of the person
    void hit_limb(const SwingingLimb& limb, double pitch_rad, const glm::dvec3& ray_origin,
                  const glm::dvec3& ray_direction) {
        const double c = std::cos(pitch_rad), s = std::sin(pitch_rad);
        // Rotates a vector so that the limb hangs straight down, as intersect_capsule()
        // expects.
        const auto hanging = [&](const glm::dvec3& vector) {
            return glm::dvec3(c * vector.x + s * vector.z, vector.y, c * vector.z - s * vector.x);
        };
        const glm::dvec3 d = hanging(ray_direction);
        const ShapeHit m =
            intersect_capsule(limb.radius_m, limb.length_m, hanging(ray_origin - limb.joint_m), d);
        if (!(m.t <= nearest_m_)) return;
        nearest_m_ = m.t;
        hit_ = StreetHit{m.t, std::abs(glm::dot(m.normal, d)), limb.reflectance, SurfaceClass::person};
    }

    const std::optional<StreetHit>& nearest_hit() const { return hit_; }

private:
    const WorldRay& ray_;
    double nearest_m_;
    std::optional<StreetHit> hit_;
};

Pose MovingStreetActor::world_from_box_at(double time_s) const {
    if (!track.pose.empty()) return track.pose_at(time_s);
    const glm::dvec3 ahead(std::cos(yaw_rad), std::sin(yaw_rad), 0.0);
    return {glm::angleAxis(yaw_rad, glm::dvec3(0, 0, 1)), start_m + speed_mps * time_s * ahead};
}

double MovingStreetActor::walked_m(double time_s) const {
    if (track.pose.empty()) return speed_mps * time_s;
    const glm::dvec3 ahead(std::cos(yaw_rad), std::sin(yaw_rad), 0.0);
    double walked = glm::dot(track.pose.front().translation - start_m, ahead);
    for (std::size_t i = 1; i < track.pose.size() && track.time_s[i - 1] < time_s; ++i) {
        // share of the step from pose i - 1 to pose i that is walked until time_s
        const double share =
            std::min(1.0, (time_s - track.time_s[i - 1]) / (track.time_s[i] - track.time_s[i - 1]));
        walked += share * glm::distance(glm::dvec2(track.pose[i].translation),
                                        glm::dvec2(track.pose[i - 1].translation));
    }
    return walked;
}

std::vector<StreetCaster::RayCastShape> StreetCaster::prepare_shapes(std::span<const StreetShape> shapes) {
    std::vector<RayCastShape> solids;
    for (const StreetShape& shape : shapes)
        solids.push_back({shape, bounding_sphere(shape), std::cos(shape.yaw_rad), std::sin(shape.yaw_rad)});
    return solids;
}

/// Groups consecutive shapes into clusters, so that a ray that misses the bounding sphere
/// of a cluster skips all its shapes.
StreetCaster::StreetCaster(SyntheticStreet street) {
    // maximum radius of a group of shapes, such as a car, a bush or a part of a fence
    constexpr double kMaxClusterRadius_m = 4.0;
    const std::span<const StreetShape> shapes = street.shapes;
    std::size_t begin = 0;
    while (begin < shapes.size()) {
        std::size_t end = begin + 1;
        while (end < shapes.size() &&
               bounding_sphere(shapes.subspan(begin, end + 1 - begin)).radius_m < kMaxClusterRadius_m)
            ++end;
        const std::span<const StreetShape> cluster = shapes.subspan(begin, end - begin);
        clusters_.push_back({bounding_sphere(cluster), prepare_shapes(cluster)});
        begin = end;
    }
    for (MovingStreetActor& car : street.cars) add_actor(std::move(car));
}

void StreetCaster::add_actor(MovingStreetActor moving) {
    const std::string_view category = moving.category;
    SurfaceClass surface = SurfaceClass::vehicle;
    if (category == "Pedestrian") surface = SurfaceClass::person;
    if (category == "Cyclist") surface = SurfaceClass::cyclist;
    for (StreetShape& shape : moving.shapes) shape.surface = surface;
    RayCastActor& actor = actors_.emplace_back();
    actor.solids = prepare_shapes(moving.shapes);
    actor.moving = std::move(moving);
    for (const RayCastShape& s : actor.solids)
        actor.reach_m = std::max(actor.reach_m, glm::length(s.around.centre) + s.around.radius_m);
    for (const SwingingLimb& l : actor.moving.limbs)
        actor.reach_m = std::max(actor.reach_m, glm::length(l.joint_m) + l.length_m + l.radius_m);
}

/// Computes the poses of all actors, unless `actor_poses` already has those of this time.
void StreetCaster::place_actors(double time_s, ActorPoses& actor_poses) const {
    if (actor_poses.time_s == time_s) return;
    actor_poses.time_s = time_s;
    actor_poses.centre_m.clear();
    actor_poses.box_from_world.clear();
    for (const RayCastActor& actor : actors_) {
        const Pose world_from_box = actor.moving.world_from_box_at(time_s);
        actor_poses.centre_m.push_back(world_from_box.translation);
        actor_poses.box_from_world.push_back(inverse(world_from_box));
    }
}

std::optional<StreetHit> StreetCaster::find_first_hit(const WorldRay& ray, double time_s, double max_range_m,
                                                      ActorPoses& actor_poses) const {
    NearestSurfaceSearch search(ray, max_range_m);
    search.hit_ground();
    for (const Cluster& cluster : clusters_)
        if (!search.can_skip_sphere(cluster.around, ray.origin_m, ray.direction))
            for (const RayCastShape& solid : cluster.solids)
                search.hit_solid(solid, ray.origin_m, ray.direction);
    place_actors(time_s, actor_poses);
    for (std::size_t i = 0; i < actors_.size(); ++i) {
        const RayCastActor& actor = actors_[i];
        if (search.can_skip_sphere({actor_poses.centre_m[i], actor.reach_m}, ray.origin_m, ray.direction))
            continue;
        // Moves the ray to the frame of the box, in which the shapes of the actor are.
        const Pose& box_from_world = actor_poses.box_from_world[i];
        const glm::dvec3 origin = box_from_world * ray.origin_m,
                         direction = box_from_world.rotation * ray.direction;
        for (const RayCastShape& solid : actor.solids) search.hit_solid(solid, origin, direction);
        if (actor.moving.limbs.empty()) continue;
        // Each stride is one period, in which every limb swings forth and back.
        const double stride_rad = 2.0 * kPi * actor.moving.walked_m(time_s) / actor.moving.stride_m;
        for (const SwingingLimb& limb : actor.moving.limbs) {
            const double angle_rad = limb.swing_rad * std::sin(stride_rad + limb.phase_rad);
            search.hit_limb(limb, angle_rad, origin, direction);
        }
    }
    return search.nearest_hit();
}

// The returns of a conical beam follow. Tests compare src/simulate/render/footprint.cpp
// with this code, which is independent and samples the cone in other directions: along a
// golden-angle spiral.
namespace {

constexpr double kGoldenAngle_rad = 2.399963229728653;
// A second return needs at least this distance. The minimum intensity prevents a division
// by zero for black surfaces.
constexpr float kMinSeparation_m = 0.5f, kMinIntensity = 1e-3f;

/// A hit of a thin ray, or a return of a beam: its range, and its light as the sum of the
/// intensities of the thin rays. A white surface that fills the beam has the light
/// kConeRays.
struct ConeHit {
    float range_m = 0.0f, light = 0.0f;
    auto operator<=>(const ConeHit&) const = default;
};

/// Returns the hits of the thin rays of a beam, sorted by range.
std::vector<ConeHit> list_hits(const Scan& cone_scan, std::size_t beam) {
    std::vector<ConeHit> hits;
    for (std::size_t i = beam * kConeRays; i < (beam + 1) * kConeRays; ++i)
        if (cone_scan.range_m[i] > 0.0f)
            hits.push_back({cone_scan.range_m[i], std::max(cone_scan.intensity[i], kMinIntensity)});
    std::sort(hits.begin(), hits.end());
    return hits;
}

/// Combines hits to returns, sorted by range. A hit that is less than kMinSeparation_m
/// behind the hit before it belongs to the same return. The range of a return is the mean
/// range of its hits, weighted by light.
std::vector<ConeHit> group_hits(const std::vector<ConeHit>& hits) {
    std::vector<ConeHit> returns;
    float last_m = -1e9f;
    for (const ConeHit& hit : hits) {
        if (hit.range_m - last_m >= kMinSeparation_m) returns.emplace_back();
        returns.back().range_m += hit.range_m * hit.light;
        returns.back().light += hit.light;
        last_m = hit.range_m;
    }
    for (ConeHit& r : returns) r.range_m /= r.light;
    return returns;
}

/// Returns true if a receiver detects a return. Data sheets give the maximum range for a
/// reflectivity of 80 %. The received power falls with the square of the range, so the
/// weakest reflectivity grows with it, from 0.25 % at a short range.
bool is_detected(const ConeHit& hit, double max_range_m) {
    constexpr double kFarReflectivity = 0.8, kNearReflectivity = 0.0025;
    const double range_share = double(hit.range_m) / max_range_m;
    const double weakest = std::max(kFarReflectivity * range_share * range_share, kNearReflectivity);
    return double(hit.light) >= weakest * kConeRays;
}

/// Returns the second of the two returns that a receiver reports: the last one, or the
/// next strongest one if the strongest is the last. Empty without another return.
/// @param returns  sorted by range; `strongest` is an index
ConeHit find_second(const std::vector<ConeHit>& returns, std::size_t strongest) {
    if (strongest + 1 < returns.size()) return returns.back();
    ConeHit second;
    for (std::size_t r = 0; r < strongest; ++r)
        if (returns[r].light > second.light) second = returns[r];
    return second;
}

}  // namespace

RayTable make_cone_rays(const RayTable& rays) {
    RayTable cone;
    cone.rows = rays.rows;
    cone.columns = rays.columns * kConeRays;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        // d, side and d x side are orthogonal. The helper axis is never parallel to d.
        const glm::dvec3 d(rays.direction[i]);
        const glm::dvec3 helper = std::abs(d.z) < 0.9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0);
        const glm::dvec3 side = glm::normalize(glm::cross(d, helper));
        for (int k = 0; k < kConeRays; ++k) {
            // The square root spreads the rays evenly over the area of the cone.
            const double angle = 0.5 * rays.divergence_of_rad(i) * std::sqrt((k + 0.5) / kConeRays);
            // Direction from the beam axis to thin ray k. Steps of the golden angle
            // spread the rays evenly around the axis.
            const double around_rad = 1.0 + k * kGoldenAngle_rad;  // any start is as good
            const glm::dvec3 outward =
                std::cos(around_rad) * side + std::sin(around_rad) * glm::cross(d, side);
            cone.direction.emplace_back(std::cos(angle) * d + std::sin(angle) * outward);
            cone.origin.push_back(rays.origin[i]);
            cone.time_offset_s.push_back(rays.time_offset_s[i]);
            cone.channel.push_back(rays.channel[i]);
        }
    }
    return cone;
}

Scan combine_cone(const RayTable& rays, const Scan& scan_of_cone_rays, double max_range_m) {
    Scan scan{
        .rays = rays, .range_m = ScanArray<float>(rays.size()), .intensity = ScanArray<float>(rays.size())};
    AdditionalReturns& second_returns = scan.second_returns.emplace_back(
        AdditionalReturns{std::vector<float>(rays.size()), std::vector<float>(rays.size())});
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const std::vector<ConeHit> hits = list_hits(scan_of_cone_rays, i);
        // A beam has a return only if more than half of its thin rays hit a surface.
        if (2 * int(hits.size()) <= kConeRays) continue;
        const std::vector<ConeHit> returns = group_hits(hits);
        const auto strongest = std::ranges::max_element(returns, {}, &ConeHit::light);
        // The intensity is the mean light of all thin rays of the beam.
        scan.range_m[i] = strongest->range_m;
        scan.intensity[i] = std::min(strongest->light / kConeRays, 1.0f);
        const ConeHit second = find_second(returns, std::size_t(strongest - returns.begin()));
        if (!is_detected(second, max_range_m)) continue;
        second_returns.range_m[i] = second.range_m;
        second_returns.intensity[i] = second.light / kConeRays;
    }
    return scan;
}

}  // namespace relidar::street
