// SPDX-License-Identifier: Apache-2.0
// Sorts the packets of a LiDAR in the order of sending. A network may deliver packets
// late, twice or not at all. Also finds the azimuth sector in which the sensor does not
// fire.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {

/// A packet in the index of a recording. A packet that spans a sector without firings has
/// two entries, one for each side of the sector.
struct PacketIndexEntry {
    /// Times of the first firing: receive time stamp, and unwrapped time on the sensor's
    /// clock.
    std::int64_t stamp_ns, clock_ns;
    double azimuth_deg;  ///< unwrapped azimuth of the first firing in degrees
    float turned_deg;    ///< rotation of the head from the first to the last firing
    /// Angle of the skipped sector between these firings and the packet's time. Negative
    /// if the firings precede the sector. 0 for most packets.
    float skipped_deg;
    std::uint32_t message;
    std::uint16_t in_message;  ///< index in the message
    std::uint16_t first_firing, n_firings;
    std::int16_t first_slot;  ///< slot of the first firing
    std::int16_t n_slots;     ///< number of slots
    std::uint32_t hash;       ///< hash of the packet's bytes
    /// number of packets without a firing that directly precede this packet
    std::uint16_t n_empty_before = 0;
};

/// Returns the angle that the head turns from one azimuth to the next, below 360 degrees.
/// If the next azimuth is slightly behind because of encoder noise, the angle is
/// negative.
double compute_rotation_deg(double from_azimuth_deg, double to_azimuth_deg);

/// Number of packets that were received twice or late.
struct PacketFaultCounts {
    std::size_t n_repeated = 0, n_late = 0;
};
/// Sorts packets by the sensor's clock and removes repeated packets. A packet whose clock
/// is much earlier is not moved, because its clock was set back.
PacketFaultCounts sort_and_deduplicate_packets(std::vector<PacketIndexEntry>& packets);

/// Unwraps the azimuths of sorted packets, and corrects the times of packets that span a
/// sector without firings.
/// @return mean rotation rate in degrees per microsecond
double unwrap_azimuths_and_estimate_rate(std::vector<PacketIndexEntry>& packets, const FiringTiming& timing);

/// Azimuth sector in which the sensor never fires.
struct SkippedSector {
    double begin_deg = 0.0, width_deg = 0.0;  ///< width 0: no such sector

    /// Returns how many degrees of the sector are between two unwrapped azimuths.
    double compute_sector_overlap_deg(double from_deg, double to_deg) const;
};
/// Finds the azimuth sector in which the sensor never fires. Requires the sector in at
/// least two revolutions, because a gap in one revolution can be packet loss.
/// @param firing_step_deg  azimuth step between two firings
SkippedSector find_sector_without_firings(const std::vector<PacketIndexEntry>& packets,
                                          double firing_step_deg);

}  // namespace relidar::packets
