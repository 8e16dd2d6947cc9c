// SPDX-License-Identifier: Apache-2.0
#include "train/drops/sensor_drop.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "base/parallel.hpp"

namespace relidar {
namespace {

// Image columns per azimuth bin, so that each bin gets enough rays.
constexpr int kColumnsPerBin = 3;
// bins on each side over which the local drop rate is averaged
constexpr int kNeighbourBins = 2;
// With fewer rays, a hole in the scene would look like a blind spot of the sensor.
constexpr std::uint32_t kMinRaysPerRate = 60;
// Number of virtual rays that stabilise a drop rate if a bin has few real rays:
//   rate of a bin = (drops + kPriorRays * local rate) / (rays + kPriorRays)
//   local rate    = drops / (rays + kPriorRays), summed over the bin and its neighbours
constexpr double kPriorRays = 8.0;
// minimum width of a sector without returns, as a share of the full circle
constexpr double kMinSectorShare = 10.0 / 360.0;
// A beam is blind at an azimuth if at least this share of its rays is dropped.
constexpr float kMinBlindRate = 0.95f;

int count_azimuth_bins(const Log& sequence) {
    int columns = 0;
    for (const Lidar& lidar : sequence.lidars) columns = std::max(columns, lidar.sensor.columns);
    return std::max(1, columns / kColumnsPerBin);
}

/// Calls visit_sector(first, n) for each sector, which is a run of n neighbouring bins
/// that fulfil a condition. Ignores sectors narrower than kMinSectorShare. Does nothing
/// if all bins fulfil the condition.
template <class Condition, class Visit>
void for_each_sector(int n_bins, const Condition& is_bin_in_sector, const Visit& visit_sector) {
    // Starts at a bin outside all sectors, so that a sector across bin 0 is not split.
    int begin = 0;
    while (begin < n_bins && is_bin_in_sector(begin)) ++begin;
    if (begin == n_bins) return;
    for (int k = 1, run = 0; k <= n_bins; ++k) {  // the last bin is `begin`, which is outside all sectors
        if (is_bin_in_sector((begin + k) % n_bins)) {
            ++run;
            continue;
        }
        if (run > 0 && double(run) >= kMinSectorShare * double(n_bins)) visit_sector(begin + k - run, run);
        run = 0;
    }
}

}  // namespace

RayDropCounts::RayDropCounts(const Log& sequence)
    : sequence_(sequence),
      index_{int(sequence.count_beams()), count_azimuth_bins(sequence), {}},
      rays_(std::size_t(index_.channels) * std::size_t(index_.bins), 0),
      drops_(rays_.size(), 0) {}

void RayDropCounts::add_ray(const Frame& frame, std::size_t ray) {
    const auto beam = sequence_.find_global_beam(frame.lidar, frame.scan.rays.channel[ray]);
    if (!beam) return;
    const std::size_t slot = index_.index_of(*beam, frame.scan.rays.direction[ray]);
    std::atomic_ref(rays_[slot]).fetch_add(1, std::memory_order_relaxed);
    if (!(frame.scan.range_m[ray] > 0.0f))
        std::atomic_ref(drops_[slot]).fetch_add(1, std::memory_order_relaxed);
}

/// Computes the rates of persistent drops. From each bin, grows an interval until it has
/// enough rays, and gives its rate to all of its bins. A bin keeps the maximum.
RayDropTable RayDropCounts::persistent_rates() const {
    RayDropTable table = index_;
    table.probability.assign(rays_.size(), 0.0f);
    const auto share = [](std::uint32_t drops, std::uint32_t rays) { return float(drops) / float(rays); };
    for (int channel = 0; channel < index_.channels; ++channel)
        for (int first = 0; first < index_.bins; ++first) {
            std::uint32_t rays = 0, drops = 0;
            int end = first;
            for (; end < first + index_.bins && rays < kMinRaysPerRate; ++end) {
                rays += rays_[bin_index(channel, end)];
                drops += drops_[bin_index(channel, end)];
            }
            if (rays < kMinRaysPerRate) continue;
            for (int bin = first; bin < end; ++bin) {
                const std::size_t i = bin_index(channel, bin);
                const float bin_share = rays_[i] > 0 ? share(drops_[i], rays_[i]) : 1.0f;
                table.probability[i] =
                    std::max(table.probability[i], std::min(bin_share, share(drops, rays)));
            }
        }
    for (int channel = 0; channel < index_.channels; ++channel) drop_unfired(table, channel);
    return table;
}

/// Sets the drop rate of a beam to 1 in sectors in which it never fires.
void RayDropCounts::drop_unfired(RayDropTable& drop_table, int channel) const {
    for_each_sector(
        index_.bins, [&](int bin) { return rays_[bin_index(channel, bin)] == 0; },
        [&](int first, int count) {
            for (int bin = first; bin < first + count; ++bin)
                drop_table.probability[bin_index(channel, bin)] = 1.0f;
        });
}

/// Returns the drop rate of a bin and its neighbours together. Adds kPriorRays returned
/// rays, so that the rate is low if the bins have few rays.
double RayDropCounts::local_rate(int channel, int bin) const {
    double rays = kPriorRays, drops = 0.0;
    for (int b = bin - kNeighbourBins; b <= bin + kNeighbourBins; ++b) {
        const std::size_t i = bin_index(channel, b);
        rays += double(rays_[i]);
        drops += double(drops_[i]);
    }
    return drops / rays;
}

RayDropTable RayDropCounts::smoothed_rates() const {
    RayDropTable table = index_;
    for (int channel = 0; channel < index_.channels; ++channel)
        for (int bin = 0; bin < index_.bins; ++bin) {
            const std::size_t i = bin_index(channel, bin);
            const double drops = double(drops_[i]) + kPriorRays * local_rate(channel, bin);
            table.probability.push_back(static_cast<float>(drops / (double(rays_[i]) + kPriorRays)));
        }
    return table;
}

RayDropTable measure_drops(const Log& sequence, const std::vector<int>& frame_indices) {
    RayDropCounts counts(sequence);
    parallel_for(static_cast<int>(frame_indices.size()), [&](int k) {
        const Frame& frame = sequence.frames[std::size_t(frame_indices[std::size_t(k)])];
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) counts.add_ray(frame, i);
    });
    return counts.persistent_rates();
}

void drop_unobserved(RayDropTable& drop_table, const RayDropTable& observed_drop_rates, const Log& sequence) {
    const int bins = observed_drop_rates.bins;
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l) {
        const SpinningSensor& sensor = sequence.lidars[l].sensor;
        std::vector<std::size_t> rows;  // first bin of each beam
        for (std::size_t beam = 0; beam < sensor.beams.size(); ++beam)
            if (const auto number = sequence.find_global_beam(int(l), std::uint16_t(beam)))
                rows.push_back(std::size_t(*number) * std::size_t(bins));
        if (rows.empty()) continue;
        const auto is_blind_at = [&](std::size_t row, int bin) {
            return observed_drop_rates.probability[row + std::size_t((bin + bins) % bins)] >= kMinBlindRate;
        };
        const auto [least, most] = std::ranges::minmax(sensor.beams, {}, &Beam::azimuth_offset_rad);
        // difference between the largest and the smallest azimuth offset, in bins
        const int spread =
            int(std::ceil((most.azimuth_offset_rad - least.azimuth_offset_rad) / (2.0 * kPi) * bins));
        for_each_sector(
            bins,
            [&](int bin) {
                return std::ranges::all_of(rows, [&](std::size_t row) { return is_blind_at(row, bin); });
            },
            [&](int first, int count) {
                for (const std::size_t row : rows) {
                    // All beams are blind in these `count` bins. Because the beams have
                    // different azimuth offsets, one beam can be blind in a few more bins
                    // on each side. Extends the range begin..end by these bins.
                    int begin = first, end = first + count;
                    while (first - begin < spread && is_blind_at(row, begin - 1)) --begin;
                    while (end - first - count < spread && is_blind_at(row, end)) ++end;
                    for (int bin = begin; bin < end; ++bin)
                        drop_table.probability[row + std::size_t((bin + bins) % bins)] = 1.0f;
                }
            });
    }
}

bool is_blind_ray(const RayDropTable& observed, const Log& log, const Frame& frame, std::size_t ray) {
    const auto beam = log.find_global_beam(frame.lidar, frame.scan.rays.channel[ray]);
    return beam && observed.probability_of(*beam, frame.scan.rays.direction[ray]) >= kMinBlindRate;
}

}  // namespace relidar
