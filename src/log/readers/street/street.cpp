// SPDX-License-Identifier: Apache-2.0
// Intersects rays exactly with the shapes of the synthetic street: the ground plane,
// upright boxes (slab test), and upright cylinders with caps (quadratic equation in the
// plane):
//   box: t_axis = (+-half - o) / d;   cylinder: |o_xy + t d_xy| = r, |z| <= half height
#include "log/readers/street/street.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <string_view>
#include <utility>

namespace relidar::street {
namespace {

/// Point at which a ray hits a shape, in the frame of the shape.
struct Meeting {
    double t = std::numeric_limits<double>::infinity();
    glm::dvec3 normal{0.0};
};

Meeting intersect_box(const glm::dvec3& half, const glm::dvec3& origin, const glm::dvec3& direction) {
    double enter = -std::numeric_limits<double>::infinity(), leave = -enter;
    int axis = 0;
    for (int a = 0; a < 3; ++a) {
        if (direction[a] == 0.0) {
            if (std::abs(origin[a]) > half[a]) return {};
            continue;
        }
        const double side = std::copysign(half[a], direction[a]);
        const double near = (-side - origin[a]) / direction[a], far = (side - origin[a]) / direction[a];
        if (near > enter) enter = near, axis = a;
        leave = std::min(leave, far);
    }
    if (!(enter > 0.0) || enter > leave) return {};
    Meeting meeting{enter, glm::dvec3(0.0)};
    meeting.normal[axis] = -std::copysign(1.0, direction[axis]);
    return meeting;
}

Meeting intersect_cylinder(double radius, double half_height, const glm::dvec3& origin,
                           const glm::dvec3& direction) {
    const double a = direction.x * direction.x + direction.y * direction.y,
                 b = origin.x * direction.x + origin.y * direction.y,
                 c = origin.x * origin.x + origin.y * origin.y - radius * radius;
    Meeting best;
    const double root = b * b - a * c;
    if (a > 0.0 && root >= 0.0) {
        const double t = (-b - std::sqrt(root)) / a;
        const glm::dvec3 p = origin + t * direction;
        if (t > 0.0 && std::abs(p.z) <= half_height) best = {t, glm::dvec3(p.x, p.y, 0.0) / radius};
    }
    if (direction.z != 0.0) {
        const double cap = -std::copysign(half_height, direction.z), t = (cap - origin.z) / direction.z;
        const glm::dvec3 p = origin + t * direction;
        if (t > 0.0 && t < best.t && p.x * p.x + p.y * p.y <= radius * radius)
            best = {t, {0.0, 0.0, std::copysign(1.0, cap)}};
    }
    return best;
}

/// Intersects a ray with a capsule whose axis points down from the origin.
Meeting intersect_capsule(double radius, double length, const glm::dvec3& origin,
                          const glm::dvec3& direction) {
    Meeting best;
    const auto offer = [&](double t, double axis_z) {
        if (t > 0.0 && t < best.t)
            best = {t, (origin + t * direction - glm::dvec3(0.0, 0.0, axis_z)) / radius};
    };
    const double a = direction.x * direction.x + direction.y * direction.y,
                 b = origin.x * direction.x + origin.y * direction.y,
                 c = origin.x * origin.x + origin.y * origin.y - radius * radius;
    if (const double root = b * b - a * c; a > 0.0 && root >= 0.0) {
        const double t = (-b - std::sqrt(root)) / a, z = origin.z + t * direction.z;
        if (z <= 0.0 && z >= -length) offer(t, z);
    }
    for (const double end : {0.0, -length}) {
        const glm::dvec3 to = origin - glm::dvec3(0.0, 0.0, end);
        const double half = glm::dot(to, direction), rest = half * half - glm::dot(to, to) + radius * radius;
        if (rest >= 0.0) offer(-half - std::sqrt(rest), end);
    }
    return best;
}

/// Rotates a vector about the z axis by the angle with cosine c and sine s.
glm::dvec3 rotate_vector(const glm::dvec3& vector, double cosine, double sine) {
    return {cosine * vector.x - sine * vector.y, sine * vector.x + cosine * vector.y, vector.z};
}

/// Returns true if a point of a wall is in a window. Walls that face the y direction have
/// windows of dark glass, 1.2 x 1.5 m, every 3 m.
bool is_in_window(const Shape& wall, const glm::dvec3& local, const glm::dvec3& normal) {
    if (std::abs(normal.y) < 0.5) return false;
    const double u = local.x + wall.half.x, v = local.z + wall.half.z;
    return u - 3.0 * std::floor(u / 3.0) < 1.2 && v > 1.0 && v - 3.0 * std::floor(v / 3.0) > 1.5;
}

/// Returns the hit of a ray on the ground. The ground consists of a road with a dashed
/// centre line, and pavements on both sides.
/// @param range_m,cosine  range and cosine of the hit
Hit make_ground_hit(const glm::dvec3& point, double range_m, double cosine) {
    const double middle = std::abs(point.y - 1.7);
    const bool dash = middle < 0.08 && point.x - 6.0 * std::floor(point.x / 6.0) < 3.0;
    if (middle < 4.2) return {range_m, cosine, dash ? 0.8 : 0.18, SurfaceClass::road};
    return {range_m, cosine, 0.32, SurfaceClass::sidewalk};
}

SurfaceClass find_class(std::string_view category) {
    return category == "Pedestrian" ? SurfaceClass::person
           : category == "Cyclist"  ? SurfaceClass::cyclist
                                    : SurfaceClass::vehicle;
}

/// Returns the bounding sphere of a shape, through the corners of its box.
Sphere compute_bounding_sphere(const Shape& shape) { return {shape.centre, glm::length(shape.half)}; }

/// Returns a bounding sphere of several shapes, centred in the bounding box of their
/// centres.
Sphere compute_bounding_sphere(std::span<const Shape> shapes) {
    glm::dvec3 low = shapes.front().centre, high = low;
    for (const Shape& shape : shapes) low = glm::min(low, shape.centre), high = glm::max(high, shape.centre);
    Sphere around{0.5 * (low + high)};
    for (const Shape& shape : shapes) {
        const Sphere s = compute_bounding_sphere(shape);
        around.radius_m = std::max(around.radius_m, glm::distance(around.centre, s.centre) + s.radius_m);
    }
    return around;
}

}  // namespace

/// Finds the first surface that a ray hits. The caller passes all shapes to it, one after
/// another.
class StreetCaster::Walk {
public:
    Walk(const WorldRay& ray, double max_range_m) : ray_(ray), nearest_m_(max_range_m) {}

    /// Returns true if the shapes in a sphere can be skipped: the ray misses the sphere,
    /// or has a nearer hit already.
    bool misses_sphere(const Sphere& sphere, const glm::dvec3& origin, const glm::dvec3& direction) const {
        const glm::dvec3 to = sphere.centre - origin;
        const double along = glm::dot(to, direction), radius2 = sphere.radius_m * sphere.radius_m;
        if (glm::dot(to, to) - along * along > radius2) return true;
        return along < -sphere.radius_m || along - sphere.radius_m > nearest_m_;
    }

    void intersect_ground() {
        if (!(ray_.direction.z < 0.0)) return;
        const double t = -ray_.origin_m.z / ray_.direction.z;
        if (!(t > 0.0) || t > nearest_m_) return;
        nearest_m_ = t;
        hit_ = make_ground_hit(ray_.origin_m + t * ray_.direction, t, -ray_.direction.z);
    }

    /// Intersects the ray with a shape, and stores the hit if it is the nearest so far.
    /// @param origin,direction  ray in the frame of the shape's centre
    void intersect_solid(const Solid& solid, const glm::dvec3& origin, const glm::dvec3& direction) {
        if (misses_sphere(solid.around, origin, direction)) return;
        const Shape& shape = solid.shape;
        const double c = solid.cos_yaw, s = -solid.sin_yaw;
        const glm::dvec3 o = rotate_vector(origin - shape.centre, c, s), d = rotate_vector(direction, c, s);
        const Meeting m = shape.kind == Shape::Kind::box
                              ? intersect_box(shape.half, o, d)
                              : intersect_cylinder(shape.half.x, shape.half.z, o, d);
        if (!(m.t <= nearest_m_)) return;
        nearest_m_ = m.t;
        const bool glass = shape.material == Material::wall && is_in_window(shape, o + m.t * d, m.normal);
        hit_ = Hit{m.t, std::abs(glm::dot(m.normal, d)), glass ? 0.06 : shape.reflectance, shape.surface};
    }

    /// Intersects the ray with an arm or a leg, and stores the hit if it is the nearest
    /// so far.
    /// @param pitch_rad  swing angle of the limb, from straight down to the front
    /// @param origin,direction  ray in the frame of the person's box
    void intersect_limb(const Limb& limb, double pitch_rad, const glm::dvec3& origin,
                        const glm::dvec3& direction) {
        const double c = std::cos(pitch_rad), s = std::sin(pitch_rad);
        const auto hanging = [&](const glm::dvec3& vector) {
            return glm::dvec3(c * vector.x + s * vector.z, vector.y, c * vector.z - s * vector.x);
        };
        const glm::dvec3 d = hanging(direction);
        const Meeting m = intersect_capsule(limb.radius_m, limb.length_m, hanging(origin - limb.joint_m), d);
        if (!(m.t <= nearest_m_)) return;
        nearest_m_ = m.t;
        hit_ = Hit{m.t, std::abs(glm::dot(m.normal, d)), limb.reflectance, SurfaceClass::person};
    }

    const std::optional<Hit>& hit() const { return hit_; }

private:
    const WorldRay& ray_;
    double nearest_m_;
    std::optional<Hit> hit_;
};

Pose MovingCar::world_from_box(double t_s) const {
    if (!track.pose.empty()) return track.at(t_s);
    const glm::dvec3 ahead(std::cos(yaw_rad), std::sin(yaw_rad), 0.0);
    return {glm::angleAxis(yaw_rad, glm::dvec3(0, 0, 1)), start_m + speed_mps * t_s * ahead};
}

double MovingCar::compute_walked_m(double t_s) const {
    if (track.pose.empty()) return speed_mps * t_s;
    const glm::dvec3 ahead(std::cos(yaw_rad), std::sin(yaw_rad), 0.0);
    double walked = glm::dot(track.pose.front().translation - start_m, ahead);
    for (std::size_t i = 1; i < track.pose.size() && track.time_s[i - 1] < t_s; ++i) {
        const double share =
            std::min(1.0, (t_s - track.time_s[i - 1]) / (track.time_s[i] - track.time_s[i - 1]));
        walked += share * glm::distance(glm::dvec2(track.pose[i].translation),
                                        glm::dvec2(track.pose[i - 1].translation));
    }
    return walked;
}

std::vector<StreetCaster::Solid> StreetCaster::make_solids(const std::vector<Shape>& shapes) {
    std::vector<Solid> solids;
    for (const Shape& shape : shapes)
        solids.push_back(
            {shape, compute_bounding_sphere(shape), std::cos(shape.yaw_rad), std::sin(shape.yaw_rad)});
    return solids;
}

StreetCaster::StreetCaster(Street street) : solids_(make_solids(street.shapes)) {
    // maximum radius of a group of shapes, such as a car, a bush or a part of a fence
    constexpr double kWide_m = 4.0;
    const std::span<const Shape> shapes = street.shapes;
    for (std::size_t begin = 0, end = 1; begin < shapes.size(); begin = end, ++end) {
        while (end < shapes.size() &&
               compute_bounding_sphere(shapes.subspan(begin, end + 1 - begin)).radius_m < kWide_m)
            ++end;
        clusters_.push_back({compute_bounding_sphere(shapes.subspan(begin, end - begin)), end});
    }
    for (MovingCar& car : street.cars) {
        for (Shape& shape : car.shapes) shape.surface = find_class(car.category);
        Car& new_car = cars_.emplace_back(Car{std::move(car), {}});
        new_car.solids = make_solids(new_car.moving.shapes);
        for (const Solid& s : new_car.solids)
            new_car.reach_m = std::max(new_car.reach_m, glm::length(s.around.centre) + s.around.radius_m);
        for (const Limb& l : new_car.moving.limbs)
            new_car.reach_m = std::max(new_car.reach_m, glm::length(l.joint_m) + l.length_m + l.radius_m);
    }
}

void StreetCaster::compute_car_poses(double t_s, CarPlaces& places) const {
    if (places.time_s == t_s) return;
    places.time_s = t_s;
    places.centre_m.clear();
    places.box_from_world.clear();
    for (const Car& car : cars_) {
        const Pose world_from_box = car.moving.world_from_box(t_s);
        places.centre_m.push_back(world_from_box.translation);
        places.box_from_world.push_back(inverse(world_from_box));
    }
}

std::optional<Hit> StreetCaster::cast(const WorldRay& ray, double t_s, double max_range_m,
                                      CarPlaces& places) const {
    Walk walk(ray, max_range_m);
    walk.intersect_ground();
    std::size_t solid = 0;
    for (const Cluster& cluster : clusters_) {
        if (!walk.misses_sphere(cluster.around, ray.origin_m, ray.direction))
            for (; solid < cluster.end; ++solid)
                walk.intersect_solid(solids_[solid], ray.origin_m, ray.direction);
        solid = cluster.end;
    }
    compute_car_poses(t_s, places);
    for (std::size_t i = 0; i < cars_.size(); ++i) {
        const Car& car = cars_[i];
        if (walk.misses_sphere({places.centre_m[i], car.reach_m}, ray.origin_m, ray.direction)) continue;
        const Pose& box_from_world = places.box_from_world[i];
        const glm::dvec3 origin = box_from_world * ray.origin_m,
                         direction = box_from_world.rotation * ray.direction;
        for (const Solid& s : car.solids) walk.intersect_solid(s, origin, direction);
        if (car.moving.limbs.empty()) continue;
        const double stride_rad = 2.0 * kPi * car.moving.compute_walked_m(t_s) / car.moving.stride_m;
        for (const Limb& l : car.moving.limbs)
            walk.intersect_limb(l, l.swing_rad * std::sin(stride_rad + l.phase_rad), origin, direction);
    }
    return walk.hit();
}

std::optional<Hit> StreetCaster::cast(const WorldRay& ray, double t_s, double max_range_m) const {
    CarPlaces places;
    return cast(ray, t_s, max_range_m, places);
}

}  // namespace relidar::street
