// SPDX-License-Identifier: Apache-2.0
// Groups the packets of a spinning LiDAR into sweeps. Works for all products with a
// decoder.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {

/// One revolution of the LiDAR's head. It begins and ends when the head faces backward.
struct PacketTurn {
    /// Time at which the head faced forward, and the time at which that packet was
    /// recorded.
    std::int64_t forward_ns = 0, log_ns = 0;
    std::size_t first = 0, last = 0;  ///< packets of the revolution
    /// Head angle at the start of the revolution, counted over the full recording without
    /// wrapping. The revolution ends 360 degrees later.
    double begin_deg = 0.0;
    std::size_t n_missing = 0;  ///< number of lost packets in the revolution
    /// Stamp minus sensor clock for the packet with the smallest network delay. Used only
    /// if the sensor's clock determines the times.
    std::int64_t stamp_less_clock_ns = 0;
};

/// Index of a topic's packets. Stores for each packet its time, the angle of the head,
/// and the message that contains the packet.
class PacketLog {
public:
    /// Adds the packets of one message to the index.
    /// @param calibration  known calibration data of the sensor
    /// @throws DataError with the product if the packets cannot be decoded, or if the
    /// product changes
    void add(const std::vector<PacketView>& packets, std::int64_t log_ns, const bag::Place& place,
             const Calibration& calibration);
    bool empty() const { return packets_.empty(); }
    std::size_t size() const { return packets_.size(); }
    /// Returns the complete revolutions.
    std::vector<PacketTurn> turns() const;
    /// Position of a message in the recording, and the time at which the message was
    /// recorded.
    struct Source {
        bag::Place place;
        std::int64_t log_ns;
    };
    /// Returns the messages that contain the packets of a revolution.
    std::vector<Source> messages(const PacketTurn& turn) const;
    /// Returns the model of the sensor, with the rotation rate measured from the packets.
    SpinningSensor sensor() const;
    std::string about() const;
    /// Decodes the packets of a revolution and returns its scan. The times of rays are
    /// relative to `zero_ns`.
    /// @param packets  packets of each message that messages() returns
    Scan scan(const PacketTurn& turn, const std::vector<std::vector<PacketView>>& packets,
              const SpinningSensor& sensor, std::int64_t zero_ns) const;

private:
    struct Entry {
        /// times of the packet's first firing; the sensor's clock is counted without
        /// wrapping
        std::int64_t stamp_ns, clock_ns;
        double azimuth_deg;  ///< unwrapped azimuth of its first firing
        float turned_deg;    ///< rotation from its first firing to its last
        std::uint32_t message;
        std::uint16_t in_message;  ///< index in the message
        std::int16_t first_slot;   ///< slot of its first firing
    };
    std::shared_ptr<const Decoder> decoder_;
    const Product* product_ = nullptr;
    Calibration calibration_;
    int n_slots_ = 1;  ///< slots per packet
    std::vector<Entry> packets_;
    std::vector<Source> messages_;
    /// [255 x intensity] number of returns with this intensity; empty unless intensities
    /// may exceed 1
    std::vector<std::uint32_t> n_bright_;

    void check_product(const PacketView& packet, const Calibration& calibration);
    void add_packet(const PacketView& view, std::uint16_t in_message);
    double step_deg() const;
    std::pair<double, double> reach_deg() const;
    void mark_missing(const PacketTurn& turn, std::size_t packet, std::vector<bool>& has_fired) const;
    int column_in(const PacketTurn& turn, double azimuth_deg) const;
    std::size_t steps_to(std::size_t packet) const;
    std::size_t count_missing_before(std::size_t packet) const;
    bool is_even(const PacketTurn& turn) const;
    void find_times(PacketTurn& turn) const;
    double slot_deg(const PacketTurn& turn) const;
    double brightest() const;
    double intensity_max() const;
    Packet reread_packet(const PacketTurn& turn, const Entry& entry,
                         const std::vector<std::vector<PacketView>>& packets) const;
};

}  // namespace relidar::packets
