// SPDX-License-Identifier: Apache-2.0
// Packets of a VLP-16 (Velodyne's manual 63-9243, chapters 6 and 9) as sweeps: every firing is there, so rays that were dropped are known.
// A packet of 1206 bytes is 12 blocks of 0xEEFF, azimuth (0.01 degrees, clockwise), 32 x (range in 2 mm, reflectivity); then a time in
// microseconds of the hour, the mode of returns and the product. Lasers 0 to 15 fire 2.304 us apart, all of them every 55.296 us, twice a
// block. Where each ray has two returns, two blocks are of the same firings: the first has the last return and the second the strongest.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/reader.hpp>

#include "dataset/bag/bag.hpp"
#include "dataset/bag/messages.hpp"

namespace relidar::bag {

/// A packet of a message.
struct PacketView {
    std::int64_t stamp_ns = 0;
    std::string_view bytes;
};
/// Packets of velodyne_msgs/VelodyneScan. @throws DataError
std::vector<PacketView> read_packets(const Topic& topic, std::string_view bytes, Header& header);

/// A turn of the head, from behind to behind.
struct PacketTurn {
    std::int64_t forward_ns = 0, log_ns = 0;  ///< when the head faced forward; when that packet was recorded
    std::size_t first = 0, last = 0;          ///< packets that hold it
    double begin_deg = 0.0;                   ///< of the head, unwrapped over the whole recording; 360 degrees more is its end
    std::size_t n_missing = 0;                ///< packets of it that are not there
};

/// The packets of a topic: when each was measured, where the head was, and in which message it lies.
class PacketLog {
public:
    /// @throws DataError naming the product where it is another than a VLP-16
    void add(const std::vector<PacketView>& packets, std::int64_t log_ns, const Place& place);
    bool empty() const { return packets_.empty(); }
    /// Whole turns.
    std::vector<PacketTurn> turns() const;
    /// Messages that hold the packets of a turn.
    std::vector<Place> places(const PacketTurn& turn) const;
    /// The sensor, turning as fast as it did.
    SpinningSensor sensor() const;
    /// The scan of a turn; times of rays are from `zero_ns`. @param packets  of places(), all of them in their order
    Scan scan(const PacketTurn& turn, const std::vector<PacketView>& packets, const SpinningSensor& sensor, std::int64_t zero_ns) const;

private:
    struct Packet {
        std::int64_t stamp_ns;
        std::int64_t device_us;  ///< of the sensor's clock, hours added
        double azimuth_deg;      ///< of its first block, unwrapped
        double turned_deg;       ///< from its first block to its last
        std::uint32_t message;
        std::uint32_t in_message;  ///< its number there
        bool two_returns;
    };
    struct Source {
        Place place;
        std::int64_t log_ns;
    };
    std::vector<Packet> packets_;
    std::vector<Source> messages_;

    void add_packet(const PacketView& packet);
    bool is_even(const PacketTurn& turn) const;
};

}  // namespace relidar::bag
