// SPDX-License-Identifier: Apache-2.0
// Generates a deterministic synthetic street of surfels and the rays of its sensor
// (docs/method.md section 2). Draws the same random numbers in the same order as the
// Python generator ../shared/bench/scene_gen.py. The random generator is numpy's legacy
// RandomState: MT19937 with an integer seed and 53-bit uniform numbers. Normal numbers
// come from the polar method, which makes two numbers at a time.
#include "scene/benchmark_street.hpp"

#include <cmath>
#include <random>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

constexpr double kStreetLength_m = 160.0, kHalfWidth_m = 12.0, kFacadeHeight_m = 9.0;
constexpr double kShC0 = 0.28209479177387814;
const glm::vec3 kSensor_m(0.0f, -2.0f, 1.8f);

/// Random generator with the same output as numpy.random.RandomState(seed).
class NumpyRandomState {
public:
    explicit NumpyRandomState(std::uint32_t seed) : generator_(seed) {}

    /// Draws from 0 to 1 with 53 random bits: 27 bits of one number and 26 of the next.
    double draw_uniform() {
        const std::uint32_t high = std::uint32_t(generator_()) >> 5, low = std::uint32_t(generator_()) >> 6;
        return (high * 0x1p26 + low) / 0x1p53;
    }
    /// Draws from the standard normal distribution by Marsaglia's polar method, which
    /// yields two numbers at a time. The second one is kept for the next call.
    double draw_normal() {
        if (has_next_) {
            has_next_ = false;
            return next_;
        }
        double x, y, r2;
        do {
            x = 2.0 * draw_uniform() - 1.0;
            y = 2.0 * draw_uniform() - 1.0;
            r2 = x * x + y * y;
        } while (r2 >= 1.0 || r2 == 0.0);
        const double scale = std::sqrt(-2.0 * std::log(r2) / r2);
        next_ = scale * x;
        has_next_ = true;
        return scale * y;
    }

private:
    std::mt19937 generator_;
    double next_ = 0.0;
    bool has_next_ = false;
};

/// Rectangle of the street: a facade, one face of a car, or the ground.
struct Rectangle {
    glm::dvec3 corner, edge_u, edge_v;
    double intensity;
    glm::dvec3 normal = glm::normalize(glm::cross(edge_u, edge_v));
    double area = glm::length(glm::cross(edge_u, edge_v));
};
using Rectangles = std::vector<Rectangle>;
using RectangleIndices = std::vector<std::uint16_t>;

/// Adds the sides and the top of a car, whose body begins 0.2 m above the ground. The
/// normal of a face is edge_u x edge_v. The order of the edges makes it point outwards.
void append_car(const glm::dvec3& centre, double intensity, Rectangles& rectangles) {
    const double length = 4.4, width = 1.8, height = 1.5 - 0.2;
    const glm::dvec3 x(length, 0, 0), y(0, width, 0), z(0, 0, height);
    const glm::dvec3 base = centre + glm::dvec3(-0.5 * length, -0.5 * width, 0.2);
    const auto add_face = [&](const glm::dvec3& corner, const glm::dvec3& edge_u, const glm::dvec3& edge_v) {
        rectangles.push_back({corner, edge_u, edge_v, intensity});
    };
    add_face(base, x, z);           // right
    add_face(base + y + x, -x, z);  // left
    add_face(base + y, -y, z);      // rear
    add_face(base + x, y, z);       // front
    add_face(base + z, x, y);       // top
}

/// Returns the rectangles of the ground, the facades and the parked cars. The street
/// follows the x axis. The seed is fixed, so the layout is always the same.
Rectangles make_rectangles() {
    NumpyRandomState random(1);
    const double half = kStreetLength_m / 2;
    Rectangles rectangles{
        {{-half, -kHalfWidth_m, 0}, {kStreetLength_m, 0, 0}, {0, 2 * kHalfWidth_m, 0}, 0.2}};  // ground
    for (const int side : {-1, 1}) {
        // Facades, 8 to 18 m wide, which face the street. A tenth are gaps.
        for (double x = -half; x < half - 1e-9;) {
            const double width = std::min(8 + 10 * random.draw_uniform(), half - x);
            const double setback = 1.5 * random.draw_uniform();
            const double intensity = 0.25 + 0.4 * random.draw_uniform();
            const bool gap = random.draw_uniform() < 0.1;
            const double y = side * (kHalfWidth_m - setback);
            const glm::dvec3 up(0, 0, kFacadeHeight_m);
            // The first edge has the sign of `side`, so that the normal faces the street.
            const double corner_x = side > 0 ? x : x + width;
            if (!gap) rectangles.push_back({{corner_x, y, 0}, {side * width, 0, 0}, up, intensity});
            x += width;
        }
        // Parked cars, 6.5 m apart. Three of ten places are free.
        for (double x = -half + 3; x < half - 5; x += 6.5) {
            const bool skip = random.draw_uniform() < 0.3;
            const double along = random.draw_uniform();
            const double across = 0.3 * random.draw_uniform();
            const double intensity = 0.3 + 0.6 * random.draw_uniform();
            if (!skip) append_car({x + along, side * (7.5 + across), 0.0}, intensity, rectangles);
        }
    }
    return rectangles;
}

/// Picks a random rectangle for each surfel, with a probability proportional to its area.
RectangleIndices sample_rectangles(std::size_t n, const Rectangles& rectangles, NumpyRandomState& random) {
    std::vector<double> cumulative;
    double total = 0.0;
    for (const Rectangle& r : rectangles) {
        total += r.area;
        cumulative.push_back(total);
    }
    for (double& c : cumulative) c /= total;
    RectangleIndices indices(n);
    for (std::uint16_t& index : indices) {
        const auto chosen = std::ranges::upper_bound(cumulative, random.draw_uniform()) - cumulative.begin();
        // Rounding can leave the last sum below 1.
        index = std::uint16_t(std::min<std::ptrdiff_t>(chosen, std::ptrdiff_t(rectangles.size()) - 1));
    }
    return indices;
}

/// Places each surfel at random on its rectangle, with a normally distributed offset of
/// 2 cm along the normal. Draws numbers in the order of the Python generator.
void sample_positions(const Rectangles& rectangles, const RectangleIndices& indices, NumpyRandomState& random,
                      Surfels& surfels) {
    std::vector<glm::dvec2> uv(indices.size());  // position on the rectangle, 0 to 1
    for (glm::dvec2& position : uv) {
        position.x = random.draw_uniform();
        position.y = random.draw_uniform();
    }
    for (std::size_t i = 0; i < indices.size(); ++i) {
        const Rectangle& r = rectangles[indices[i]];
        surfels.mean[i] = glm::vec3(r.corner + uv[i].x * r.edge_u + uv[i].y * r.edge_v +
                                    r.normal * (0.02 * random.draw_normal()));
    }
}

/// Returns the unit quaternion (w, x, y, z) of a rotation matrix with these columns. The
/// largest component of the quaternion is positive. Row k of `candidates` is 4 q_k q, so
/// the row with the largest q_k is the most accurate.
glm::dvec4 quaternion_of_axes(const glm::dvec3& x_axis, const glm::dvec3& y_axis, const glm::dvec3& z_axis) {
    const double trace = x_axis.x + y_axis.y + z_axis.z;
    const std::array<glm::dvec4, 4> candidates{
        {{1 + trace, y_axis.z - z_axis.y, z_axis.x - x_axis.z, x_axis.y - y_axis.x},
         {y_axis.z - z_axis.y, 1 + 2 * x_axis.x - trace, x_axis.y + y_axis.x, z_axis.x + x_axis.z},
         {z_axis.x - x_axis.z, x_axis.y + y_axis.x, 1 + 2 * y_axis.y - trace, y_axis.z + z_axis.y},
         {x_axis.y - y_axis.x, z_axis.x + x_axis.z, y_axis.z + z_axis.y, 1 + 2 * z_axis.z - trace}}};
    int best = 0;
    for (int k = 1; k < 4; ++k)
        if (candidates[k][k] > candidates[best][best]) best = k;
    return glm::normalize(candidates[best]);
}

/// Draws random rotations. The normals scatter around the normals of the rectangles, and
/// the rotation about the normal is uniform.
void sample_rotations(const Rectangles& rectangles, const RectangleIndices& indices, NumpyRandomState& random,
                      Surfels& surfels) {
    std::vector<glm::dvec3> normal(indices.size());
    for (std::size_t i = 0; i < indices.size(); ++i) {
        glm::dvec3 noise;
        for (int axis = 0; axis < 3; ++axis) noise[axis] = random.draw_normal();
        normal[i] = glm::normalize(rectangles[indices[i]].normal + 0.05 * noise);
    }
    for (std::size_t i = 0; i < indices.size(); ++i) {
        const glm::dvec3 z = normal[i];
        const glm::dvec3 helper = std::abs(z.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0);
        const glm::dvec3 x0 = glm::normalize(glm::cross(helper, z)), y0 = glm::cross(z, x0);
        const double phi = 2.0 * kPi * random.draw_uniform();
        const glm::dvec3 x = std::cos(phi) * x0 + std::sin(phi) * y0;
        surfels.rotation[i] = glm::vec4(quaternion_of_axes(x, glm::cross(z, x), z));
    }
}

/// Draws scales from 0.1 to 0.3 m, whose logarithms are uniformly distributed, and then
/// opacities from 0.1 to 0.99.
/// @param shrink  scales the surfels, so that their area is that of kUnscaledSurfels
void sample_scales(bool shrink, NumpyRandomState& random, Surfels& surfels) {
    constexpr double kUnscaledSurfels = 1e5, kMinScale_m = 0.1, kScaleRatio = 3.0;
    const double factor = shrink ? std::sqrt(kUnscaledSurfels / double(surfels.mean.size())) : 1.0;
    for (glm::vec2& log_scale : surfels.log_scale)
        for (int axis = 0; axis < 2; ++axis) {
            const double scale_m = kMinScale_m * std::pow(kScaleRatio, random.draw_uniform()) * factor;
            log_scale[axis] = float(std::log(scale_m));
        }
    for (float& logit : surfels.opacity_logit) {
        const double opacity = 0.1 + 0.89 * random.draw_uniform();
        logit = float(std::log(opacity / (1.0 - opacity)));
    }
}

/// Draws random spherical harmonics (SH) of three channels: intensity, hit logit, drop
/// logit. First draws degree 0, which sets the mean of a channel, then the other degrees.
/// scene_gen.py rounds the coefficients to the same steps, half to even.
void sample_harmonics(const Rectangles& rectangles, const RectangleIndices& indices, NumpyRandomState& random,
                      Surfels& surfels) {
    enum Channel { kIntensity, kHitLogit, kDropLogit };
    constexpr double kMeanSteps = 4096, kOtherSteps = 256;  // steps per unit
    const auto set_coefficient = [&](std::size_t surfel, int channel, int k, double value) {
        surfels.sh[surfel * kShFloats + std::size_t(channel * kShCoefficients + k)] = float(value);
    };
    const auto set_mean = [&](std::size_t surfel, int channel, double mean) {
        // value = 0.5 + kShC0 * coefficient
        const double steps = std::clamp(std::nearbyint((mean - 0.5) / kShC0 * kMeanSteps), -32000.0, 32000.0);
        set_coefficient(surfel, channel, 0, steps / kMeanSteps);
    };
    const std::size_t n = indices.size();
    for (std::size_t i = 0; i < n; ++i) {
        const double intensity = rectangles[indices[i]].intensity + 0.08 * random.draw_normal();
        set_mean(i, kIntensity, std::clamp(intensity, 0.02, 0.98));
    }
    for (std::size_t i = 0; i < n; ++i) set_mean(i, kHitLogit, 1.0 + 0.3 * random.draw_normal());
    for (std::size_t i = 0; i < n; ++i) set_mean(i, kDropLogit, 0.3 * random.draw_normal());
    for (std::size_t i = 0; i < n; ++i)
        for (int k = 1; k < kShCoefficients; ++k)
            for (int channel = 0; channel < kShChannels; ++channel) {
                const double steps =
                    std::clamp(std::nearbyint(0.05 * random.draw_normal() * kOtherSteps), -127.0, 127.0);
                set_coefficient(i, channel, k, steps / kOtherSteps);
            }
}

}  // namespace

Surfels make_street_surfels(std::uint32_t n_surfels, std::uint32_t seed, bool shrink) {
    const Rectangles rectangles = make_rectangles();
    NumpyRandomState random(seed);
    Surfels surfels;
    surfels.resize(n_surfels);
    // The order of these calls determines the random numbers, so it must not change.
    const RectangleIndices index = sample_rectangles(n_surfels, rectangles, random);
    sample_positions(rectangles, index, random, surfels);
    sample_rotations(rectangles, index, random, surfels);
    sample_scales(shrink, random, surfels);
    sample_harmonics(rectangles, index, random, surfels);
    return surfels;
}

RayTable make_street_rays(int rows, int columns, double top_deg, double bottom_deg) {
    if (rows <= 0 || columns <= 0) throw UsageError("make_street_rays: rows and columns must be positive");
    RayTable table;
    table.rows = rows;
    table.columns = columns;
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    table.origin.assign(n, kSensor_m);
    table.time_offset_s.assign(n, 0.0f);
    // Cell centres: rows from top to bottom, columns clockwise from azimuth pi.
    for (int row = 0; row < rows; ++row) {
        const double elevation = (top_deg + (row + 0.5) / rows * (bottom_deg - top_deg)) * (kPi / 180.0);
        for (int column = 0; column < columns; ++column) {
            const double azimuth = kPi - (column + 0.5) / columns * 2.0 * kPi;
            table.direction.emplace_back(std::cos(elevation) * std::cos(azimuth),
                                         std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
            table.channel.push_back(std::uint16_t(row));
        }
    }
    return table;
}

RayTable make_street_rays(const std::string& name) {
    if (name == "waymo") return make_street_rays(64, 2650, 2.4, -17.6);
    if (name == "kitti") return make_street_rays(66, 1030, 2.0, -24.9);
    throw UsageError("make_street_rays: found \"" + name + "\", expected waymo or kitti");
}

}  // namespace relidar
