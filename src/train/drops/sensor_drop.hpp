// SPDX-License-Identifier: Apache-2.0
// Sensor-level ray-drop (paper section 3.5), estimated from the training frames in two
// steps: rays that hardly ever return are kept out of the losses, so the scene does not
// learn the vehicle's own shadow as a property of the ground; after training, the share
// of drops among the rays for which the scene alone expects a return is the sensor's own.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Rays and drops counted by beam (Sequence::beam_number) and azimuth bin.
class DropCounts {
public:
    /// Geometry for the LiDARs of a log, which has to outlive this: a row a beam, and
    /// azimuth bins of about three columns.
    explicit DropCounts(const Sequence& sequence);
    /// A ray of a frame of the log. Several threads may add at a time.
    void add(const Frame& frame, std::size_t ray);
    /// Share of drops among as many bins side by side as it takes to be certain (60 rays:
    /// of 20 sweeps in one bin, or of 20 bins in one sweep): of those that hold a bin,
    /// the ones that dropped most, and never more than the bin's own. 0 where a whole
    /// turn has fewer.
    DropTable persistent() const;
    /// Share of drops of each bin, where a log is short, too: a bin is drawn towards the
    /// bins beside it, as if it had 8 more rays of their share, and these towards 0, as
    /// if 8 more of their rays had returned.
    DropTable shrunk() const;
    std::size_t bins() const { return rays_.size(); }

private:
    const Sequence& sequence_;
    DropTable index_;  ///< for its geometry
    std::vector<std::uint32_t> rays_, drops_;

    /// Where a bin is counted; bins go round.
    std::size_t slot(int channel, int bin) const {
        return std::size_t(channel) * std::size_t(index_.bins) +
               std::size_t((bin + index_.bins) % index_.bins);
    }
    /// Share of drops that a bin and those beside it have, drawn towards 0.
    double expected(int channel, int bin) const;
};

/// How often each beam and azimuth was dropped in some frames, whatever the reason
/// (DropCounts::persistent).
DropTable observed_drops(const Sequence& sequence, const std::vector<int>& positions);

/// Whether a ray hardly ever returns by `observed` drops, 0.95 of the time: it is not
/// used in training.
bool is_blind(const DropTable& observed, const Sequence& sequence, const Frame& frame, std::size_t ray);

}  // namespace relidar
