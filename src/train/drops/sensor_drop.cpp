// SPDX-License-Identifier: Apache-2.0
// Counts dropped rays by beam and azimuth.
#include "train/drops/sensor_drop.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr int kColumnsPerBin = 3;
// The expected drop rate of an azimuth bin is averaged over this many neighbouring bins
// on each side.
constexpr int kNeighbours = 2;
// Minimum number of rays from which a drop rate is computed. With fewer rays, a blind
// spot of the sensor cannot be distinguished from a hole in the scene.
constexpr std::uint32_t kCertainRays = 60;
// Weight of the prior in a drop rate, as a number of rays. The rate of the neighbouring
// bins is computed with this many additional returned rays. The rate of a bin is computed
// with this many additional rays that drop with the neighbours' rate.
constexpr double kPriorRays = 8.0;
// minimum width of a sector without returns, as a share of the full circle
constexpr double kLeastSector = 10.0 / 360.0;
constexpr float kBlindFrequency = 0.95f;

int count_bins(const Sequence& sequence) {
    int columns = 0;
    for (const Lidar& lidar : sequence.lidars) columns = std::max(columns, lidar.sensor.columns);
    return std::max(1, columns / kColumnsPerBin);
}

/// Calls visit(first, n) for each sector, which is a run of neighbouring bins that fulfil
/// a condition. Ignores sectors that are narrower than the minimum. Does nothing if all
/// bins fulfil the condition.
template <class Condition, class Visit>
void for_each_sector(int bins, const Condition& is_in, const Visit& visit) {
    int begin = 0;
    while (begin < bins && is_in(begin)) ++begin;
    if (begin == bins) return;
    for (int k = 1, run = 0; k <= bins; ++k) {  // ends at the bin outside where it begins
        if (is_in((begin + k) % bins)) {
            ++run;
            continue;
        }
        if (run > 0 && double(run) >= kLeastSector * double(bins)) visit(begin + k - run, run);
        run = 0;
    }
}

/// Returns how much the azimuth offsets of a LiDAR's beams differ: largest minus
/// smallest, in bins.
int compute_azimuth_spread_bins(const SpinningSensor& sensor, int bins) {
    const auto [least, most] = std::ranges::minmax(sensor.beams, {}, &Beam::azimuth_offset_rad);
    return int(std::ceil((most.azimuth_offset_rad - least.azimuth_offset_rad) / (2.0 * kPi) * bins));
}

}  // namespace

DropCounts::DropCounts(const Sequence& sequence)
    : sequence_(sequence),
      index_{int(sequence.count_beams()), count_bins(sequence), {}},
      rays_(std::size_t(index_.channels) * std::size_t(index_.bins), 0),
      drops_(rays_.size(), 0) {}

void DropCounts::add(const Frame& frame, std::size_t ray) {
    const auto beam = sequence_.find_beam_number(frame.lidar, frame.scan.rays.channel[ray]);
    if (!beam) return;
    const std::size_t slot = index_.index(*beam, frame.scan.rays.direction[ray]);
    std::atomic_ref(rays_[slot]).fetch_add(1, std::memory_order_relaxed);
    if (!(frame.scan.range_m[ray] > 0.0f))
        std::atomic_ref(drops_[slot]).fetch_add(1, std::memory_order_relaxed);
}

DropTable DropCounts::estimate_persistent_rate() const {
    DropTable table = index_;
    table.probability.assign(rays_.size(), 0.0f);
    const auto share = [](std::uint32_t drops, std::uint32_t rays) { return float(drops) / float(rays); };
    for (int channel = 0; channel < index_.channels; ++channel)
        for (int first = 0; first < index_.bins; ++first) {
            std::uint32_t rays = 0, drops = 0;
            int end = first;
            for (; end < first + index_.bins && rays < kCertainRays; ++end)
                rays += rays_[get_bin_index(channel, end)], drops += drops_[get_bin_index(channel, end)];
            if (rays < kCertainRays) continue;
            for (int bin = first; bin < end; ++bin) {
                const std::size_t i = get_bin_index(channel, bin);
                const float bin_share = rays_[i] > 0 ? share(drops_[i], rays_[i]) : 1.0f;
                table.probability[i] =
                    std::max(table.probability[i], std::min(bin_share, share(drops, rays)));
            }
        }
    for (int channel = 0; channel < index_.channels; ++channel) add_skipped_sectors(table, channel);
    return table;
}

void DropCounts::add_skipped_sectors(DropTable& table, int channel) const {
    for_each_sector(
        index_.bins, [&](int bin) { return rays_[get_bin_index(channel, bin)] == 0; },
        [&](int first, int count) {
            for (int bin = first; bin < first + count; ++bin)
                table.probability[get_bin_index(channel, bin)] = 1.0f;
        });
}

double DropCounts::estimate_bin_drop_rate(int channel, int bin) const {
    double rays = kPriorRays, drops = 0.0;
    for (int b = bin - kNeighbours; b <= bin + kNeighbours; ++b) {
        const std::size_t i = get_bin_index(channel, b);
        rays += double(rays_[i]);
        drops += double(drops_[i]);
    }
    return drops / rays;
}

DropTable DropCounts::estimate_drop_rate() const {
    DropTable table = index_;
    for (int channel = 0; channel < index_.channels; ++channel)
        for (int bin = 0; bin < index_.bins; ++bin) {
            const std::size_t i = get_bin_index(channel, bin);
            const double drops = double(drops_[i]) + kPriorRays * estimate_bin_drop_rate(channel, bin);
            table.probability.push_back(static_cast<float>(drops / (double(rays_[i]) + kPriorRays)));
        }
    return table;
}

DropTable estimate_observed_drops(const Sequence& sequence, const std::vector<int>& positions) {
    DropCounts counts(sequence);
    parallel_for(static_cast<int>(positions.size()), [&](int k) {
        const Frame& frame = sequence.frames[std::size_t(positions[std::size_t(k)])];
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) counts.add(frame, i);
    });
    return counts.estimate_persistent_rate();
}

void add_unseen_sectors(DropTable& drops, const DropTable& observed, const Sequence& sequence) {
    const int bins = observed.bins;
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l) {
        const SpinningSensor& sensor = sequence.lidars[l].sensor;
        std::vector<std::size_t> rows;  // first bin of each beam
        for (std::size_t beam = 0; beam < sensor.beams.size(); ++beam)
            if (const auto number = sequence.find_beam_number(int(l), std::uint16_t(beam)))
                rows.push_back(std::size_t(*number) * std::size_t(bins));
        if (rows.empty()) continue;
        const auto is_blind_at = [&](std::size_t row, int bin) {
            return observed.probability[row + std::size_t((bin + bins) % bins)] >= kBlindFrequency;
        };
        const int spread = compute_azimuth_spread_bins(sensor, bins);
        for_each_sector(
            bins,
            [&](int bin) {
                return std::ranges::all_of(rows, [&](std::size_t row) { return is_blind_at(row, bin); });
            },
            [&](int first, int count) {
                for (const std::size_t row : rows) {
                    // The azimuth offsets differ between beams. Extends the sector of
                    // each beam by neighbouring bins that have hardly any returns.
                    int begin = first, end = first + count;
                    while (first - begin < spread && is_blind_at(row, begin - 1)) --begin;
                    while (end - first - count < spread && is_blind_at(row, end)) ++end;
                    for (int bin = begin; bin < end; ++bin)
                        drops.probability[row + std::size_t((bin + bins) % bins)] = 1.0f;
                }
            });
    }
}

bool is_blind(const DropTable& observed, const Sequence& sequence, const Frame& frame, std::size_t ray) {
    const auto beam = sequence.find_beam_number(frame.lidar, frame.scan.rays.channel[ray]);
    return beam && observed.at(*beam, frame.scan.rays.direction[ray]) >= kBlindFrequency;
}

}  // namespace relidar
