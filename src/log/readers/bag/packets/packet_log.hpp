// SPDX-License-Identifier: Apache-2.0
// Packets of a spinning LiDAR as sweeps, whatever product sent them.
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

/// A turn of the head, from behind to behind.
struct PacketTurn {
    /// when the head faced forward; when that packet was recorded
    std::int64_t forward_ns = 0, log_ns = 0;
    std::size_t first = 0, last = 0;  ///< packets that hold it
    /// of the head, unwrapped over the whole recording; 360 degrees more is its end
    double begin_deg = 0.0;
    std::size_t n_missing = 0;  ///< packets of it that are not there
    /// where the sensor's clock tells the times: of the packet that was received fastest
    std::int64_t stamp_less_clock_ns = 0;
};

/// The packets of a topic: when each was measured, where the head was, and in which
/// message it lies.
class PacketLog {
public:
    /// @param calibration  of the sensor, as far as it is known
    /// @throws DataError naming the product where it is none that is decoded, or another
    /// one than before
    void add(const std::vector<PacketView>& packets, std::int64_t log_ns, const bag::Place& place,
             const Calibration& calibration);
    bool empty() const { return packets_.empty(); }
    std::size_t size() const { return packets_.size(); }
    /// Whole turns.
    std::vector<PacketTurn> turns() const;
    /// A message.
    struct Source {
        bag::Place place;
        std::int64_t log_ns;
    };
    /// Those that hold the packets of a turn.
    std::vector<Source> messages(const PacketTurn& turn) const;
    /// The sensor, turning as fast as it did.
    SpinningSensor sensor() const;
    std::string about() const;
    /// The scan of a turn; times of rays are from `zero_ns`. @param packets  of each of
    /// messages()
    Scan scan(const PacketTurn& turn, const std::vector<std::vector<PacketView>>& packets,
              const SpinningSensor& sensor, std::int64_t zero_ns) const;

private:
    struct Entry {
        std::int64_t stamp_ns, clock_ns;  ///< of its first firing, the sensor's clock going on
        double azimuth_deg;               ///< of its first firing, unwrapped
        float turned_deg;                 ///< from its first firing to its last
        std::uint32_t message;
        std::uint16_t in_message;  ///< its number there
        std::int16_t first_slot;   ///< of its first firing
    };
    std::shared_ptr<const Decoder> decoder_;
    const Product* product_ = nullptr;
    Calibration calibration_;
    int n_slots_ = 1;  ///< of a packet
    std::vector<Entry> packets_;
    std::vector<Source> messages_;
    std::vector<std::uint32_t> n_bright_;  ///< [255 x intensity + 1] echoes, where intensities go beyond 1

    void check_product(const PacketView& packet, const Calibration& calibration);
    void add_packet(const PacketView& view, std::uint16_t in_message);
    double step_deg() const;
    std::pair<double, double> reach_deg() const;
    void mark_missing(const PacketTurn& turn, std::size_t packet, std::vector<bool>& has_fired) const;
    int column_in(const PacketTurn& turn, double azimuth_deg) const;
    std::size_t steps_to(std::size_t packet) const;
    std::size_t missing_before(std::size_t packet) const;
    bool is_even(const PacketTurn& turn) const;
    void find_times(PacketTurn& turn) const;
    double slot_deg(const PacketTurn& turn) const;
    double brightest() const;
    double intensity_max() const;
    Packet packet_again(const PacketTurn& turn, const Entry& entry,
                        const std::vector<std::vector<PacketView>>& packets) const;
};

}  // namespace relidar::packets
