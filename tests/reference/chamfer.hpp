// SPDX-License-Identifier: Apache-2.0
// Chamfer distance of a simulated against a measured scan (Eq. 11; docs/method.md section
// 5) in double, by comparing every pair.
#pragma once

#include <vector>

#include <glm/glm.hpp>

namespace relidar::reference {

/// A ray and the two points along it; range 0 = none.
struct ChamferRay {
    glm::dvec3 origin_m{0.0};
    glm::dvec3 direction{0.0};
    double simulated_m = 0.0;
    double measured_m = 0.0;
};

/// (sum over simulated of min |a - b|^2 + sum over measured of min |a - b|^2) /
/// min(number of simulated, of measured); 0 where a cloud is empty
/// @param d_simulated  if given, receives the derivative by the simulated ranges [n], for
/// the pairs as they are
double chamfer_loss(const std::vector<ChamferRay>& rays, std::vector<double>* d_simulated = nullptr);

}  // namespace relidar::reference
