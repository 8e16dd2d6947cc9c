// SPDX-License-Identifier: Apache-2.0
#include "chamfer.hpp"

#include <algorithm>
#include <cstddef>

namespace relidar::reference {
namespace {

struct Point {
    std::size_t ray;
    glm::dvec3 position_m;
};

std::vector<Point> points(const std::vector<ChamferRay>& rays, double ChamferRay::*range) {
    std::vector<Point> result;
    for (std::size_t i = 0; i < rays.size(); ++i)
        if (rays[i].*range > 0.0)
            result.push_back({i, rays[i].origin_m + rays[i].*range * rays[i].direction});
    return result;
}

double squared(const glm::dvec3& vector) { return glm::dot(vector, vector); }

const Point& nearest(const Point& query, const std::vector<Point>& cloud) {
    return *std::min_element(cloud.begin(), cloud.end(), [&](const Point& first, const Point& second) {
        return squared(first.position_m - query.position_m) < squared(second.position_m - query.position_m);
    });
}

}  // namespace

double compute_chamfer_loss(const std::vector<ChamferRay>& rays, std::vector<double>* d_simulated) {
    const std::vector<Point> simulated = points(rays, &ChamferRay::simulated_m),
                             measured = points(rays, &ChamferRay::measured_m);
    std::vector<double> d(rays.size());
    double sum = 0.0;
    const double n = double(std::min(simulated.size(), measured.size()));
    const auto add_pair = [&](const Point& first, const Point& second) {
        const glm::dvec3 difference = first.position_m - second.position_m;
        sum += squared(difference);
        d[first.ray] += 2.0 * glm::dot(difference, rays[first.ray].direction) / n;
    };
    if (n > 0.0) {
        for (const Point& a : simulated) add_pair(a, nearest(a, measured));
        for (const Point& b : measured) add_pair(nearest(b, simulated), b);
    }
    if (d_simulated != nullptr) *d_simulated = std::move(d);
    return n > 0.0 ? sum / n : 0.0;
}

}  // namespace relidar::reference
