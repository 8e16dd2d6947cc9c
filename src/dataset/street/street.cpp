// SPDX-License-Identifier: Apache-2.0
// Exact ray casting against the ground plane, upright boxes (slabs) and upright cylinders (quadratic in the plane, capped):
//   box: t_axis = (+-half - o) / d;   cylinder: |o_xy + t d_xy| = r, |z| <= half height
#include "dataset/street/street.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace relidar::street {
namespace {

/// Where a ray meets a shape, in the shape's frame.
struct Meeting {
    double t = std::numeric_limits<double>::infinity();
    glm::dvec3 normal{0.0};
};

Meeting meet_box(const glm::dvec3& half, const glm::dvec3& o, const glm::dvec3& d) {
    double enter = -std::numeric_limits<double>::infinity(), leave = -enter;
    int axis = 0;
    for (int a = 0; a < 3; ++a) {
        if (d[a] == 0.0) {
            if (std::abs(o[a]) > half[a]) return {};
            continue;
        }
        const double side = std::copysign(half[a], d[a]);
        const double near = (-side - o[a]) / d[a], far = (side - o[a]) / d[a];
        if (near > enter) enter = near, axis = a;
        leave = std::min(leave, far);
    }
    if (!(enter > 0.0) || enter > leave) return {};
    Meeting meeting{enter, glm::dvec3(0.0)};
    meeting.normal[axis] = -std::copysign(1.0, d[axis]);
    return meeting;
}

Meeting meet_cylinder(double radius, double half_height, const glm::dvec3& o, const glm::dvec3& d) {
    const double a = d.x * d.x + d.y * d.y, b = o.x * d.x + o.y * d.y, c = o.x * o.x + o.y * o.y - radius * radius;
    Meeting best;
    const double root = b * b - a * c;
    if (a > 0.0 && root >= 0.0) {
        const double t = (-b - std::sqrt(root)) / a;
        const glm::dvec3 p = o + t * d;
        if (t > 0.0 && std::abs(p.z) <= half_height) best = {t, glm::dvec3(p.x, p.y, 0.0) / radius};
    }
    if (d.z != 0.0) {
        const double cap = -std::copysign(half_height, d.z), t = (cap - o.z) / d.z;
        const glm::dvec3 p = o + t * d;
        if (t > 0.0 && t < best.t && p.x * p.x + p.y * p.y <= radius * radius) best = {t, {0.0, 0.0, std::copysign(1.0, cap)}};
    }
    return best;
}

glm::dvec3 turned(const glm::dvec3& v, double yaw_rad) {
    const double c = std::cos(yaw_rad), s = std::sin(yaw_rad);
    return {c * v.x - s * v.y, s * v.x + c * v.y, v.z};
}

/// Windows in a wall: 1.2 x 1.5 m panes of dark glass, one every 3 x 3 m, on faces that look sideways.
bool in_window(const Shape& wall, const glm::dvec3& local, const glm::dvec3& normal) {
    if (std::abs(normal.y) < 0.5) return false;
    const double u = local.x + wall.half.x, v = local.z + wall.half.z;
    return u - 3.0 * std::floor(u / 3.0) < 1.2 && v > 1.0 && v - 3.0 * std::floor(v / 3.0) > 1.5;
}

/// The ground: road with a dashed line in its middle, pavement beside it.
double ground_reflectance(const glm::dvec3& p) {
    const double middle = std::abs(p.y - 1.7);
    const bool dash = middle < 0.08 && p.x - 6.0 * std::floor(p.x / 6.0) < 3.0;
    return dash ? 0.8 : middle < 4.2 ? 0.18 : 0.32;
}

class Caster {
public:
    Caster(const WorldRay& ray, double max_range_m) : ray_(ray), nearest_m_(max_range_m) {}

    void ground() {
        if (!(ray_.direction.z < 0.0)) return;
        const double t = -ray_.origin_m.z / ray_.direction.z;
        if (!(t > 0.0) || t > nearest_m_) return;
        nearest_m_ = t;
        hit_ = Hit{t, -ray_.direction.z, ground_reflectance(ray_.origin_m + t * ray_.direction)};
    }

    /// @param o, d ray in the frame that holds the shape's centre
    void shape(const Shape& shape, const glm::dvec3& origin, const glm::dvec3& direction) {
        const glm::dvec3 to = shape.centre - origin;  // sphere about the shape: most rays pass it by
        const double along = glm::dot(to, direction), reach = glm::dot(shape.half, shape.half);
        const double radius2 = shape.kind == Shape::Kind::box ? reach : reach + shape.half.x * shape.half.x;
        if (glm::dot(to, to) - along * along > radius2) return;
        const glm::dvec3 o = turned(-to, -shape.yaw_rad), d = turned(direction, -shape.yaw_rad);
        const Meeting m = shape.kind == Shape::Kind::box ? meet_box(shape.half, o, d) : meet_cylinder(shape.half.x, shape.half.z, o, d);
        if (!(m.t <= nearest_m_)) return;
        nearest_m_ = m.t;
        const bool glass = shape.material == Material::wall && in_window(shape, o + m.t * d, m.normal);
        hit_ = Hit{m.t, std::abs(glm::dot(m.normal, d)), glass ? 0.06 : shape.reflectance};
    }

    const std::optional<Hit>& hit() const { return hit_; }

private:
    const WorldRay& ray_;
    double nearest_m_;
    std::optional<Hit> hit_;
};

}  // namespace

Pose MovingCar::world_from_box(double t_s) const {
    if (!track.pose.empty()) return track.at(t_s);
    const glm::dvec3 ahead(std::cos(yaw_rad), std::sin(yaw_rad), 0.0);
    return {glm::angleAxis(yaw_rad, glm::dvec3(0, 0, 1)), start_m + speed_mps * t_s * ahead};
}

std::optional<Hit> cast(const Street& street, const WorldRay& ray, double t_s, double max_range_m) {
    Caster caster(ray, max_range_m);
    caster.ground();
    for (const Shape& shape : street.shapes) caster.shape(shape, ray.origin_m, ray.direction);
    for (const MovingCar& car : street.cars) {
        const Pose box_from_world = inverse(car.world_from_box(t_s));
        const glm::dvec3 origin = box_from_world * ray.origin_m, direction = box_from_world.rotation * ray.direction;
        for (const Shape& shape : car.shapes) caster.shape(shape, origin, direction);
    }
    return caster.hit();
}

}  // namespace relidar::street
