// SPDX-License-Identifier: Apache-2.0
// Estimates the ray-drop of the sensor itself (paper section 3.5) from the training
// frames, in two steps. Before training, rays that hardly ever return are excluded from
// the losses. Otherwise the scene would learn the shadow of the vehicle as a property of
// the ground. After training, the sensor's drop probability is the fraction of drops
// among the rays for which the scene expects a return.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Numbers of rays and drops by beam (Sequence::beam_number) and azimuth bin.
class DropCounts {
public:
    /// Creates the bins for the LiDARs of a log: a row for each beam, and azimuth bins
    /// of about three columns. The log must outlive this object.
    explicit DropCounts(const Sequence& sequence);
    /// Counts a ray of a frame of the log. Several threads may call it simultaneously.
    void add(const Frame& frame, std::size_t ray);
    /// Returns the fraction of drops over intervals of neighbouring bins with at least 60
    /// rays: 20 sweeps in one bin, or one sweep in 20 bins. A bin gets the highest
    /// fraction among the intervals that contain it, limited to the bin's own fraction.
    /// The fraction is 0 if all bins of a beam together have fewer rays.
    DropTable persistent() const;
    /// Returns the fraction of drops of each bin, also for a short log. A bin is averaged
    /// with the fraction of its neighbours, which counts as 8 more rays. The fraction of
    /// the neighbours is averaged with 8 returned rays.
    DropTable shrunk() const;
    std::size_t bins() const { return rays_.size(); }

private:
    const Sequence& sequence_;
    DropTable index_;  ///< used for its bins
    std::vector<std::uint32_t> rays_, drops_;

    /// Returns the index of a bin. Bin numbers wrap around.
    std::size_t slot(int channel, int bin) const {
        return std::size_t(channel) * std::size_t(index_.bins) +
               std::size_t((bin + index_.bins) % index_.bins);
    }
    /// Returns the fraction of drops of a bin and its neighbours, including the prior.
    double expected(int channel, int bin) const;
};

/// Returns how often each beam and azimuth was dropped in some frames, for any reason
/// (DropCounts::persistent).
DropTable observed_drops(const Sequence& sequence, const std::vector<int>& positions);

/// Returns true if a ray was dropped at least 95 % of the time according to `observed`.
/// Training does not use such rays.
bool is_blind(const DropTable& observed, const Sequence& sequence, const Frame& frame, std::size_t ray);

}  // namespace relidar
