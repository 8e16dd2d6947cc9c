// SPDX-License-Identifier: Apache-2.0
// Estimates from the training frames which rays the sensor itself drops (paper section
// 3.5). Before training, rays that hardly ever return are excluded from the losses,
// otherwise the scene would learn the shadow of the vehicle as a property of the ground.
// After training, only rays for which the scene predicts a return count.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Counts the rays and the dropped rays of each beam in bins of azimuth.
class RayDropCounts {
public:
    /// A row of azimuth bins of about three columns for each beam. The log must outlive
    /// this object.
    explicit RayDropCounts(const LidarSequence& sequence);
    /// Several threads may call this simultaneously.
    void add_ray_to_drop_counts(const LidarFrame& frame, std::size_t ray_index);
    /// Rates of rays that are dropped persistently. A bin gets the highest rate of all
    /// intervals of neighbouring bins with at least 60 rays that contain it, but at most
    /// its own rate; 0 if the beam has fewer than 60 rays, 1 in a sector of at least 10
    /// degrees in which the beam never fires.
    RayDropTable estimate_persistent_drop_rates() const;
    /// (drops + 8 * local rate) / (rays + 8). The local rate is (sum of drops) / (8 + sum
    /// of rays) over the bin and its neighbours.
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

/// Sets the drop probability to 1 in sectors of at least 10 degrees in which no beam of a
/// LiDAR has a return. The scene has no surfaces there.
/// @param observed_drop_rates  result of estimate_observed_drop_rates()
void mark_unobserved_sectors_as_dropped(RayDropTable& drop_table, const RayDropTable& observed_drop_rates,
                                        const LidarSequence& sequence);

/// at least 95 % of the time; training ignores such rays
bool is_ray_in_blind_sector(const RayDropTable& observed_drop_rates, const LidarSequence& sequence,
                            const LidarFrame& frame, std::size_t ray_index);

}  // namespace relidar
