// SPDX-License-Identifier: Apache-2.0
// Estimates from the training frames which rays the sensor itself drops (paper section
// 3.5). Before training, rays that hardly ever return are excluded from the losses,
// otherwise the scene would learn the shadow of the vehicle as a property of the ground.
// After training, only rays for which the scene predicts a return count.
#pragma once

#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

class RayDropCounts {
public:
    /// A row of azimuth bins of about three columns for each beam. Refers to the log.
    explicit RayDropCounts(const Log& sequence);
    /// Ignores rays that may have hit the body that carries the LiDAR. Several threads
    /// may call this simultaneously.
    void add_ray(const Frame& frame, std::size_t ray);
    /// Returns the drop rate of each bin, for rays that are dropped persistently. Uses
    /// intervals of neighbouring bins with at least 60 rays. A bin gets the highest rate
    /// of all intervals that contain it, but at most its own rate. The rate is 0 if the
    /// beam has fewer than 60 rays. It is 1 in a sector of at least 10 degrees in which
    /// the beam never fires.
    RayDropTable persistent_rates() const;
    /// Returns the drop rate of each bin, (drops + 8 * local rate) / (rays + 8). The 8
    /// virtual rays give a stable rate even if a short log has few rays per bin. The
    /// local rate is (sum of drops) / (8 + sum of rays) over the bin and its neighbours.
    RayDropTable smoothed_rates() const;
    std::size_t n_bins() const { return rays_.size(); }

private:
    const Log& sequence_;
    RayDropTable index_;  ///< contains no probabilities; used only for the layout of the bins
    std::vector<std::uint32_t> rays_, drops_;

    std::size_t bin_index(int channel, int bin) const;
    std::optional<std::pair<int, float>> grow_interval(int channel, int first_bin) const;
    void drop_unfired(RayDropTable& drop_table, int channel) const;
    double local_rate(int channel, int bin) const;
};

/// Returns the rates of persistent drops for each beam and azimuth in the given frames.
RayDropTable measure_drops(const Log& sequence, const std::vector<int>& frames);

/// Sets the drop probability to 1 in sectors of at least 10 degrees in which no beam of a
/// LiDAR has a return. The scene has no surfaces there.
/// @param observed_drop_rates  result of measure_drops()
void drop_unobserved(RayDropTable& drop_table, const RayDropTable& observed_drop_rates, const Log& sequence);

/// Returns true if the beam of this ray was dropped at least 95 % of the time at this
/// azimuth. Training ignores such rays.
bool is_blind_ray(const RayDropTable& observed, const Log& log, const Frame& frame, std::size_t ray);

}  // namespace relidar
