// SPDX-License-Identifier: Apache-2.0
#include "train/frames/sensor_drop.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr int kColumnsPerBin = 3;  // image columns per azimuth bin, so that each bin gets enough rays
constexpr std::uint32_t kMinRaysPerRate = 60;  // with fewer, a hole in the scene would look like a blind spot
constexpr double kMinSectorShare = 10.0 / 360.0;  // minimum width of a sector / full circle
constexpr float kMinBlindRate = 0.95f;  // share of dropped rays from which a beam is blind at an azimuth

int count_azimuth_bins(const Log& log) {
    int columns = 0;
    for (const Lidar& lidar : log.lidars) columns = std::max(columns, lidar.sensor.columns);
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
    int n_in_sector = 0;  // number of bins of the current sector
    // The last bin is `begin` again, which ends the last sector.
    for (int bin = begin + 1; bin <= begin + n_bins; ++bin) {
        if (is_bin_in_sector(bin % n_bins)) {
            ++n_in_sector;
            continue;
        }
        const bool is_wide = double(n_in_sector) >= kMinSectorShare * double(n_bins);
        if (n_in_sector > 0 && is_wide) visit_sector(bin - n_in_sector, n_in_sector);
        n_in_sector = 0;
    }
}

/// Returns the index of a bin of a beam. Bins wrap around the circle.
std::size_t wrapped_bin(const RayDropTable& table, std::size_t beam, int bin) {
    return beam * std::size_t(table.bins) + std::size_t((bin + table.bins) % table.bins);
}

/// Counts the rays and drops of each beam in azimuth bins of about three columns.
class RayDropCounts {
public:
    explicit RayDropCounts(const Log& log)
        : log_(log),
          index_{int(log.count_beams()), count_azimuth_bins(log), {}},
          rays_(std::size_t(index_.channels) * std::size_t(index_.bins), 0),
          drops_(rays_.size(), 0) {}
    /// Ignores rays that may have hit the body that carries the LiDAR. Several threads
    /// may call this simultaneously.
    void add_ray(const Frame& frame, std::size_t ray);
    RayDropTable persistent_rates() const;

private:
    const Log& log_;
    RayDropTable index_;  ///< contains no probabilities; used only for the layout of the bins
    std::vector<std::uint32_t> rays_, drops_;

    std::size_t bin_index(int channel, int bin) const {
        return wrapped_bin(index_, std::size_t(channel), bin);
    }
    std::optional<std::pair<int, float>> grow_interval(int channel, int first_bin) const;
    void drop_unfired(RayDropTable& drop_table, int channel) const;
};

void RayDropCounts::add_ray(const Frame& frame, std::size_t ray) {
    const auto beam = log_.find_global_beam(frame.lidar, frame.scan.rays.channel[ray]);
    const BodyTable& own_body = log_.lidar_of(frame).own_body;
    if (!beam || own_body.hides(frame.scan.rays.direction[ray], frame.scan.range_m[ray])) return;
    const std::size_t bin = index_.index_of(*beam, frame.scan.rays.direction[ray]);
    const bool has_return = frame.scan.range_m[ray] > 0.0f;
    std::atomic_ref(rays_[bin]).fetch_add(1, std::memory_order_relaxed);
    if (!has_return) std::atomic_ref(drops_[bin]).fetch_add(1, std::memory_order_relaxed);
}

/// Sums the rays of the bins from `first` on, until there are enough for a rate. The bins
/// wrap around the circle, so the end can be above the number of bins.
/// @return end of the bins, and their drop rate; nothing if the beam has fewer rays
std::optional<std::pair<int, float>> RayDropCounts::grow_interval(int channel, int first) const {
    std::uint32_t n_rays = 0, n_drops = 0;
    int end = first;
    for (; end < first + index_.bins && n_rays < kMinRaysPerRate; ++end) {
        n_rays += rays_[bin_index(channel, end)];
        n_drops += drops_[bin_index(channel, end)];
    }
    if (n_rays < kMinRaysPerRate) return std::nullopt;
    return std::pair(end, float(n_drops) / float(n_rays));
}

/// A beam can lose its rays at an azimuth in most frames, for example because the vehicle
/// hides the view. Single bins have too few rays to show this, so each bin gets the
/// largest rate of the intervals (with at least kMinRaysPerRate rays) that contain it.
RayDropTable RayDropCounts::persistent_rates() const {
    RayDropTable table = index_;
    table.probability.assign(rays_.size(), 0.0f);
    for (int channel = 0; channel < index_.channels; ++channel) {
        for (int first = 0; first < index_.bins; ++first) {
            const auto interval = grow_interval(channel, first);
            if (!interval) break;  // the beam has too few rays in all bins together
            const auto [end, interval_rate] = *interval;
            for (int bin = first; bin < end; ++bin) {
                const std::size_t i = bin_index(channel, bin);
                // Lower for a bin that drops less than other bins of the interval.
                const float bin_rate = rays_[i] > 0 ? float(drops_[i]) / float(rays_[i]) : 1.0f;
                table.probability[i] = std::max(table.probability[i], std::min(bin_rate, interval_rate));
            }
        }
        drop_unfired(table, channel);
    }
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

}  // namespace

RayDropTable measure_drops(const Log& log, const std::vector<int>& frame_indices) {
    RayDropCounts counts(log);
    parallel_for(static_cast<int>(frame_indices.size()), [&](int k) {
        const Frame& frame = log.frames[std::size_t(frame_indices[std::size_t(k)])];
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) counts.add_ray(frame, i);
    });
    return counts.persistent_rates();
}

namespace {

/// Returns the indices of the beams of a LiDAR among the beams of all LiDARs.
std::vector<std::size_t> list_global_beams(const Log& log, std::size_t lidar) {
    std::vector<std::size_t> beams;
    for (std::size_t beam = 0; beam < log.lidars[lidar].sensor.beams.size(); ++beam)
        if (const auto global_beam = log.find_global_beam(int(lidar), std::uint16_t(beam)))
            beams.push_back(std::size_t(*global_beam));
    return beams;
}

/// Returns the largest minus the smallest azimuth offset of the beams, in bins.
int azimuth_spread_bins(const SpinningSensor& sensor, int n_bins) {
    const auto [least, most] = std::ranges::minmax(sensor.beams, {}, &Beam::azimuth_offset_rad);
    const double spread_rad = most.azimuth_offset_rad - least.azimuth_offset_rad;
    return int(std::ceil(spread_rad / (2.0 * kPi) * n_bins));
}

}  // namespace

void drop_unobserved(RayDropTable& drop_table, const RayDropTable& observed_drop_rates, const Log& log) {
    const int n_bins = observed_drop_rates.bins;
    // A bin is an azimuth interval of a beam. In a blind bin, (almost) no ray returned. A
    // sector is a run of bins in which all beams of the LiDAR are blind.
    const auto is_blind_at = [&](std::size_t beam, int bin) {
        return observed_drop_rates.probability[wrapped_bin(observed_drop_rates, beam, bin)] >= kMinBlindRate;
    };
    for (std::size_t lidar = 0; lidar < log.lidars.size(); ++lidar) {
        const SpinningSensor& sensor = log.lidars[lidar].sensor;
        const std::vector<std::size_t> beams = list_global_beams(log, lidar);
        if (beams.empty()) continue;
        const auto are_all_blind_at = [&](int bin) {
            return std::ranges::all_of(beams, [&](std::size_t beam) { return is_blind_at(beam, bin); });
        };
        // Beams have different azimuth offsets, so one beam can be blind in a few more
        // bins before or after the sector [first, first + count). These are dropped, too.
        const int max_extra_bins = azimuth_spread_bins(sensor, n_bins);
        const auto drop_sector = [&](int first, int count) {
            for (const std::size_t beam : beams) {
                int begin = first, end = first + count;
                while (first - begin < max_extra_bins && is_blind_at(beam, begin - 1)) --begin;
                while (end - first - count < max_extra_bins && is_blind_at(beam, end)) ++end;
                for (int bin = begin; bin < end; ++bin)
                    drop_table.probability[wrapped_bin(drop_table, beam, bin)] = 1.0f;
            }
        };
        for_each_sector(n_bins, are_all_blind_at, drop_sector);
    }
}

bool is_blind_ray(const RayDropTable& observed, const Log& log, const Frame& frame, std::size_t ray) {
    const auto beam = log.find_global_beam(frame.lidar, frame.scan.rays.channel[ray]);
    return beam && observed.probability_of(*beam, frame.scan.rays.direction[ray]) >= kMinBlindRate;
}

}  // namespace relidar
