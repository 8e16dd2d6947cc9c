// SPDX-License-Identifier: Apache-2.0
// Estimates from the training frames which rays the sensor itself drops (paper section
// 3.5). Before training, rays that hardly ever return are excluded from the losses.
// Otherwise the scene would learn the shadow of the vehicle as a property of the ground.
// After training, the program uses only rays for which the scene predicts a return. The
// drop probability is the dropped fraction of these rays.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Counts the rays and the dropped rays of each beam in bins of azimuth.
class RayDropCounts {
public:
    /// Creates the bins for the LiDARs of a log. Each beam has a row of azimuth bins, and
    /// each bin covers about three columns. The log must outlive this object.
    explicit RayDropCounts(const LidarSequence& sequence);
    /// Several threads may call this simultaneously.
    void add_ray_to_drop_counts(const LidarFrame& frame, std::size_t ray_index);
    /// Returns the drop rate of each bin, for rays that are dropped persistently. Uses
    /// intervals of neighbouring bins with at least 60 rays, for example 20 sweeps in one
    /// bin or one sweep in 20 bins. A bin gets the highest drop rate of all intervals
    /// that contain it, but at most the drop rate of the bin itself. If a beam has fewer
    /// than 60 rays in total, its drop rate is 0. The drop rate is 1 in a sector of at
    /// least 10 degrees in which the beam never fires.
    RayDropTable estimate_persistent_drop_rates() const;
    /// Drop rate of each bin: (drops + 8 * local rate) / (rays + 8). The virtual rays
    /// give a stable rate in a short log. The local rate is (sum of drops) / (8 + sum of
    /// rays) over the bin and its neighbours.
    RayDropTable estimate_smoothed_drop_rates() const;
    std::size_t get_bin_count() const { return rays_.size(); }

private:
    const LidarSequence& sequence_;
    RayDropTable index_;  ///< contains no probabilities; used only for the layout of the bins
    std::vector<std::uint32_t> rays_, drops_;

    /// Bins before the first and after the last wrap around the circle.
    std::size_t get_bin_index(int channel, int bin) const {
        return std::size_t(channel) * std::size_t(index_.bins) +
               std::size_t((bin + index_.bins) % index_.bins);
    }
    void mark_unfired_sectors_as_dropped(RayDropTable& drop_table, int channel) const;
    /// Of a bin and its neighbours, with virtual returned rays.
    double estimate_local_drop_rate(int channel, int bin) const;
};

/// RayDropCounts::estimate_persistent_drop_rates() of the given frames.
RayDropTable estimate_observed_drop_rates(const LidarSequence& sequence,
                                          const std::vector<int>& frame_indices);

/// Sets the drop probability to 1 in sectors that a LiDAR does not observe. These are
/// sectors of at least 10 degrees in which no beam has a return. Either the sensor is set
/// to a smaller field of view, or the vehicle hides the sector. The scene has no surfaces
/// in these sectors, so it cannot predict the drops.
/// @param drop_table  input and output
/// @param observed_drop_rates  result of estimate_observed_drop_rates()
void mark_unobserved_sectors_as_dropped(RayDropTable& drop_table, const RayDropTable& observed_drop_rates,
                                        const LidarSequence& sequence);

/// Returns true if the beam of this ray was dropped at least 95 % of the time at this
/// azimuth. Training ignores such rays.
bool is_ray_in_blind_sector(const RayDropTable& observed_drop_rates, const LidarSequence& sequence,
                            const LidarFrame& frame, std::size_t ray_index);

}  // namespace relidar
