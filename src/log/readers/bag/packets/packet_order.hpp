// SPDX-License-Identifier: Apache-2.0
// Sorts the packets of a LiDAR in the order of sending, because a network may deliver
// packets late or twice. Also finds the azimuth sector in which the sensor does not fire.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {

/// A packet in the index of a recording. If the sensor skips a sector within a packet,
/// the packet has two entries, one for each side of the sector.
struct PacketIndexEntry {
    /// Time of the first firing: `stamp_ns` by the receiver's clock, `clock_ns` by the
    /// sensor's clock. If the sensor's clock restarts at 0, `clock_ns` continues without
    /// a jump.
    std::int64_t stamp_ns, clock_ns;
    double azimuth_deg;  ///< azimuth of the first firing in degrees, without jumps at 360 degrees
    float turned_deg;    ///< rotation of the head from the first to the last firing
    /// The packet's time stamp refers to its first or last firing. If a sector without
    /// firings is between that firing and this entry, this is the sector's width in
    /// degrees. It is positive if the sector precedes this entry, negative if it follows.
    /// Otherwise 0.
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

/// Returns the angle by which the head turns from one azimuth to the next, below 360
/// degrees. The result is negative if the next azimuth is slightly smaller because of
/// encoder noise.
double compute_rotation_deg(double from_azimuth_deg, double to_azimuth_deg);

/// Number of packets that were received twice or late.
struct PacketFaultCounts {
    std::size_t n_repeated = 0, n_late = 0;
};
/// Sorts packets by the sensor's clock and removes repeated packets. Does not move a
/// packet whose time is much earlier, because its clock was set back.
PacketFaultCounts sort_and_deduplicate_packets(std::vector<PacketIndexEntry>& packets);

/// Makes the azimuths continuous, without jumps at 360 degrees. Also corrects the times
/// of packets during which the head passes a sector without firings. Before the
/// correction, the firing times do not include this pause.
/// @return mean rotation rate in degrees per microsecond
double unwrap_azimuths_and_estimate_rate(std::vector<PacketIndexEntry>& packets, const FiringTiming& timing);

/// Azimuth sector in which the sensor never fires.
struct SkippedSector {
    double begin_deg = 0.0, width_deg = 0.0;  ///< width 0: no such sector

    /// Returns how many degrees between two azimuths are in this sector. The azimuths
    /// count over all revolutions, so they may exceed 360 degrees.
    double compute_sector_overlap_deg(double from_deg, double to_deg) const;
};
/// Finds the azimuth sector in which the sensor never fires. The sector must occur in at
/// least two revolutions, because a gap in one revolution can be packet loss.
/// @param firing_step_deg  azimuth step between two firings
SkippedSector find_sector_without_firings(const std::vector<PacketIndexEntry>& packets,
                                          double firing_step_deg);

}  // namespace relidar::packets
