// SPDX-License-Identifier: Apache-2.0
// Puts the packets of a LiDAR in order, as the sensor sent them. A network delivers
// packets late, twice or not at all. Also finds the sector in which the sensor does not
// fire.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {

/// A packet in the index of a recording, or a part of one. A packet has two parts if the
/// sensor skips a sector between two of its firings.
struct PacketEntry {
    /// Times of the first firing. The sensor's clock is counted without wrapping.
    std::int64_t stamp_ns, clock_ns;
    double azimuth_deg;  ///< unwrapped azimuth of the first firing
    float turned_deg;    ///< rotation from the first firing to the last
    /// Rotation of the head between this part and the time of the packet, without a
    /// firing. Negative before the time of the packet; 0 for most packets.
    float skipped_deg;
    std::uint32_t message;
    std::uint16_t in_message;  ///< index in the message
    std::uint16_t first_firing, n_firings;
    std::int16_t first_slot;  ///< slot of the first firing
    std::int16_t n_slots;     ///< number of slots
    std::uint32_t hash;       ///< hash of the packet's bytes
};

/// Returns the angle from one azimuth to another in the direction of rotation, less than
/// one revolution. Accepts a small decrease as noise of the encoder.
double degrees_on(double from_deg, double to_deg);

/// Numbers of packets that were not received in the order of sending.
struct PacketFaults {
    std::size_t n_repeated = 0, n_late = 0;
};
/// Sorts packets by the sensor's clock and removes exact repeats. A packet that is much
/// later than another one is not moved, because the clock was set back.
PacketFaults sort_packets(std::vector<PacketEntry>& packets);

/// Unwraps the azimuths of packets in order. Then corrects the times of packets in which
/// the head turns through a sector without a firing.
/// @return mean rotation rate in degrees per microsecond
double unwrap_azimuths(std::vector<PacketEntry>& packets, const Timing& timing);

/// Azimuth sector in which a sensor never fires.
struct SkippedSector {
    double begin_deg = 0.0, width_deg = 0.0;  ///< width 0: no such sector

    /// Returns how much of the sector lies between two unwrapped azimuths, in degrees.
    double between(double from_deg, double to_deg) const;
};
/// Finds the sector in which the sensor never fires. At least two revolutions must skip
/// it, because packets of a single revolution may be lost.
/// @param step_deg  azimuth step between two firings
SkippedSector find_skipped_sector(const std::vector<PacketEntry>& packets, double step_deg);

}  // namespace relidar::packets
