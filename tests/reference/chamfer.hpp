// SPDX-License-Identifier: Apache-2.0
// Computes the Chamfer distance between a simulated and a measured scan (Eq. 11;
// docs/method.md section 5) in double, by comparing all pairs of points.
#pragma once

#include <vector>

#include <glm/glm.hpp>

namespace relidar::reference {

/// A ray with a simulated and a measured range. A range of 0 means that the ray has no
/// point.
struct ChamferRay {
    glm::dvec3 origin_m{0.0};
    glm::dvec3 direction{0.0};
    double simulated_m = 0.0;
    double measured_m = 0.0;
};

/// Returns (sum over simulated of min |a - b|^2 + sum over measured of min |a - b|^2) /
/// min(number of simulated points, number of measured points). Returns 0 if a cloud is
/// empty.
/// @param d_simulated if not null, receives the derivative with respect to the simulated
/// ranges [n], with the nearest pairs fixed
double compute_chamfer_loss(const std::vector<ChamferRay>& rays, std::vector<double>* d_simulated = nullptr);

}  // namespace relidar::reference
