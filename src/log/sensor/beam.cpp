// SPDX-License-Identifier: Apache-2.0
// Converts the true range and intensity of a surface to the values that a beam measures,
// and back:
//   range_measured = range + range_offset
//   intensity_measured = clamp(gain * fall * intensity + offset, 0, 1)
#include <relidar/log/sensor.hpp>

#include <algorithm>

namespace relidar {

double Beam::to_measured_range_m(double surface_range_m) const {
    return surface_range_m > 0.0 ? std::max(surface_range_m + range_offset_m, 0.0) : surface_range_m;
}

double Beam::to_surface_range_m(double measured_range_m) const {
    return measured_range_m > 0.0 ? std::max(measured_range_m - range_offset_m, 1e-3) : measured_range_m;
}

double Beam::to_measured_intensity(double surface_intensity, double intensity_factor_at_range) const {
    return std::clamp(intensity_gain * intensity_factor_at_range * surface_intensity + intensity_offset, 0.0,
                      1.0);
}

double Beam::to_surface_intensity(double measured_intensity, double intensity_factor_at_range) const {
    return (measured_intensity - intensity_offset) / intensity_gain / intensity_factor_at_range;
}

const Beam& find_beam(const std::vector<Beam>& beams, std::size_t channel) {
    static const Beam ideal;
    return channel < beams.size() ? beams[channel] : ideal;
}

}  // namespace relidar
