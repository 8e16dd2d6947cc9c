// SPDX-License-Identifier: Apache-2.0
#include "read/scans/sweep_firings.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <functional>
#include <optional>
#include <utility>

#include "log/sensor/beam_geometry.hpp"

namespace relidar {
namespace {

// Azimuth steps per revolution to which the head azimuth is rounded (0.0055 degrees).
constexpr int kTicksPerTurn = 1 << 16;
// If more firings are missing in a revolution, firings without returns are appended. A
// few can be missing because the head does not rotate at a constant rate.
constexpr int kMostMissing = 8;

/// Returns the azimuth of the LiDAR's head for each firing (all lasers at one azimuth).
/// Interpolates firings without points between their neighbours.
std::map<int, double> firing_azimuths(const LidarPoints& points, const std::vector<int>& firing_numbers,
                                      const SpinningSensor& sensor, double azimuth_step_rad) {
    const std::vector<BeamRays> beams = make_generators(sensor.beams);
    // The deviation of a point is its head azimuth minus firing * step, the azimuth at a
    // constant rotation rate. Deviations are averaged as angles of exp(i deviation).
    std::map<int, std::complex<double>> sum_of_firing;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double head_rad = beams[points.ring[i]].azimuth_facing(glm::dvec3(points.position_m[i]));
        sum_of_firing[firing_numbers[i]] += std::polar(1.0, head_rad - firing_numbers[i] * azimuth_step_rad);
    }
    std::map<int, double> head_of_firing;
    const auto set_head = [&](int firing, double deviation_rad) {
        head_of_firing[firing] = std::remainder(deviation_rad + firing * azimuth_step_rad, 2.0 * kPi);
    };
    std::optional<std::pair<int, double>> before;  // number and deviation of the firing before
    for (const auto& [firing, sum] : sum_of_firing) {
        const double deviation_rad = std::arg(sum);
        if (before) {
            const auto [firing_before, deviation_before_rad] = *before;
            const double change_rad = std::remainder(deviation_rad - deviation_before_rad, 2.0 * kPi);
            const int n_steps = firing - firing_before;
            for (int step = 1; step < n_steps; ++step)  // firings without points
                set_head(firing_before + step, deviation_before_rad + change_rad * step / n_steps);
        }
        set_head(firing, deviation_rad);
        before = {firing, deviation_rad};
    }
    return head_of_firing;
}

/// Adds firings without returns at the end of a revolution, until the circle or the range
/// image is full. Assumes that the head rotates at a constant rate.
/// @param n_image_columns  number of columns of the range image; 0 if unknown
void append_empty_firings(std::map<int, double>& azimuths, int n_image_columns, double azimuth_step_rad) {
    const int n_full_circle = int(2.0 * kPi / std::abs(azimuth_step_rad));
    const int n_required = n_image_columns > 0 ? std::min(n_image_columns, n_full_circle) : n_full_circle;
    const int n_missing = n_required - int(azimuths.size());
    if (n_missing <= kMostMissing) return;
    const auto [last_firing, last_rad] = *azimuths.rbegin();
    for (int k = 1; k <= n_missing; ++k)
        azimuths[last_firing + k] = std::remainder(last_rad + k * azimuth_step_rad, 2.0 * kPi);
}

}  // namespace

double EncoderTickGrid::tick_step_rad() const { return 2.0 * kPi / n_ticks; }

int EncoderTickGrid::nearest_tick(double head_azimuth_rad) const {
    const long t = std::lround((head_azimuth_rad - zero_rad) / tick_step_rad()) % n_ticks;
    return int(t < 0 ? t + n_ticks : t);
}

double EncoderTickGrid::tick_azimuth_rad(int tick) const {
    return std::remainder(zero_rad + tick * tick_step_rad(), 2.0 * kPi);
}

SweepFirings fit_even_sweep(const LidarPoints& points, const SpinningSensor& sensor) {
    SweepFirings sweep{.lattice = {.n_ticks = sensor.columns}, .firings = {}};
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

SweepFirings arrange_firings(LidarPoints& points, const std::vector<int>& firing_numbers,
                             const SpinningSensor& sensor, double azimuth_step_rad) {
    std::map<int, double> heads = firing_azimuths(points, firing_numbers, sensor, azimuth_step_rad);
    append_empty_firings(heads, sensor.columns, azimuth_step_rad);
    return sort_firings(points, firing_numbers, heads);
}

SweepFirings sort_firings(LidarPoints& points, const std::vector<int>& firing_numbers,
                          const std::map<int, double>& head_azimuth_by_firing) {
    std::vector<std::pair<int, double>> by_azimuth(head_azimuth_by_firing.begin(),
                                                   head_azimuth_by_firing.end());
    std::ranges::stable_sort(by_azimuth, std::greater(), [](const auto& firing) { return firing.second; });
    SweepFirings sweep{.lattice = {.n_ticks = kTicksPerTurn}, .firings = {}};
    std::map<int, std::uint32_t> firing_index_of_number;
    for (const auto& [number, azimuth_rad] : by_azimuth) {
        firing_index_of_number[number] = std::uint32_t(sweep.firings.size());
        sweep.firings.push_back(sweep.lattice.nearest_tick(azimuth_rad));
    }
    points.firing.clear();
    for (const int number : firing_numbers) points.firing.push_back(firing_index_of_number[number]);
    return sweep;
}

}  // namespace relidar
