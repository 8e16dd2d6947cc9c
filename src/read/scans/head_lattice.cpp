// SPDX-License-Identifier: Apache-2.0
// Regular grid of the head azimuths at which a spinning LiDAR fires. The head azimuth of
// a grid step (tick) is zero + tick * 2 pi / n_ticks.
#include <relidar/read/clouds.hpp>

#include <cmath>
#include <complex>

#include "log/sensor/beam_geometry.hpp"

namespace relidar {

double EncoderTickGrid::tick_step_rad() const { return 2.0 * kPi / n_ticks; }

int EncoderTickGrid::nearest_tick(double head_azimuth_rad) const {
    const long t = std::lround((head_azimuth_rad - zero_rad) / tick_step_rad()) % n_ticks;
    return int(t < 0 ? t + n_ticks : t);
}

double EncoderTickGrid::tick_azimuth_rad(int tick) const {
    return std::remainder(zero_rad + tick * tick_step_rad(), 2.0 * kPi);
}

SweepFirings fit_even_sweep(const LidarPoints& points, const SpinningSensor& sensor) {
    SweepFirings sweep{{sensor.columns, 0.0}, {}};
    const std::vector<BeamRays> beams = make_generators(sensor.beams);
    const BeamRays ideal((Beam()));
    // Sum of exp(i n azimuth) over all points, for a grid of n columns. Its angle divided
    // by n is the mean offset of the azimuths from the grid.
    std::complex<double> sum = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const BeamRays& beam = points.ring[i] < beams.size() ? beams[points.ring[i]] : ideal;
        sum += std::polar(1.0, sensor.columns * beam.azimuth_facing(glm::dvec3(points.position_m[i])));
    }
    sweep.lattice.zero_rad = std::arg(sum) / sensor.columns;
    // A sweep begins near azimuth +pi, and its azimuth decreases. `last` is the grid step
    // with the largest azimuth up to +pi. So firing i is at step `last` - i.
    int last = sweep.lattice.nearest_tick(kPi);
    if (sweep.lattice.tick_azimuth_rad(last) < 0.0) last = (last + sensor.columns - 1) % sensor.columns;
    for (int i = 0; i < sensor.columns; ++i)
        sweep.firings.push_back((last - i + sensor.columns) % sensor.columns);
    return sweep;
}

}  // namespace relidar
