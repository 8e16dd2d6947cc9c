// SPDX-License-Identifier: Apache-2.0
// Groups the packets of a spinning LiDAR into sweeps. Supports all products for which
// relidar has a decoder.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/packets/decoder.hpp"
#include "log/readers/bag/packets/packet_order.hpp"

namespace relidar::packets {

struct FiredPoints;

/// One revolution of the LiDAR's head, from facing backward to facing backward again.
struct PacketTurn {
    /// Time at which the head faces forward, and recording time of the packet sent at
    /// that time.
    std::int64_t forward_ns = 0, log_ns = 0;
    std::size_t first = 0, last = 0;  ///< packets of the revolution
    /// Head angle at the start of the revolution, unwrapped over the full recording.
    double begin_deg = 0.0;
    /// number of lost packets, including those at the start and the end of the revolution
    std::size_t n_missing = 0;
    bool has_gaps = false;  ///< true if a part of a packet of the revolution was lost
    /// Time stamp minus sensor clock, for the packet with the least network delay. Used
    /// only if the sensor's clock defines the times.
    std::int64_t stamp_less_clock_ns = 0;
};

/// Index of the LiDAR packets of a topic, with the time, the head angle and the message
/// of each packet.
class PacketLog {
public:
    /// Adds the packets of one message to the index.
    /// @param calibration  calibration of the sensor, as far as it is known
    /// @throws DataError with the name of the product, if its packets cannot be decoded
    /// or if earlier packets came from another product
    void add(const std::vector<PacketView>& packets, std::int64_t log_ns, const bag::Place& place,
             const Calibration& calibration);
    /// Sorts the packets and finds the complete revolutions. Call it once, after the last
    /// add().
    void finish();
    bool empty() const { return packets_.empty(); }
    std::size_t size() const { return n_packets_; }
    /// Returns the complete revolutions.
    const std::vector<PacketTurn>& turns() const { return turns_; }
    /// Describes problems for the user: late and repeated packets, and why revolutions
    /// were skipped. Returns an empty string if there are no problems.
    std::string problems() const;
    /// Position of a message in the recording, and time of recording.
    struct Source {
        bag::Place place;
        std::int64_t log_ns;
    };
    /// Returns the messages that contain the packets of a revolution.
    std::vector<Source> messages(const PacketTurn& turn) const;
    /// Returns the sensor model with the measured rotation rate.
    SpinningSensor sensor() const;
    std::string about() const;
    /// Decodes the packets of a revolution to a scan, with ray times relative to
    /// `zero_ns`.
    /// @param packets  packets of each message that messages() returns
    Scan scan(const PacketTurn& turn, const std::vector<std::vector<PacketView>>& packets,
              const SpinningSensor& sensor, std::int64_t zero_ns) const;

private:
    using Entry = PacketEntry;
    /// Number of skipped revolutions by reason.
    struct LeftOut {
        std::size_t n_cut_off = 0;  ///< incomplete at the start or the end of the recording
        std::size_t n_lost = 0;     ///< at least a third of the packets were lost
        std::size_t n_jumps = 0;    ///< the sensor's clock jumped
    };
    std::shared_ptr<const Decoder> decoder_;
    const Product* product_ = nullptr;
    Calibration calibration_;
    int n_slots_ = 1;            ///< slots per packet
    std::size_t n_packets_ = 0;  ///< number of packets without repeats
    /// number of packets without a firing since the last packet with firings
    std::uint16_t n_empty_ = 0;
    std::vector<Entry> packets_;
    std::vector<Source> messages_;
    std::vector<PacketTurn> turns_;
    PacketFaults faults_;
    LeftOut left_out_;
    double deg_us_ = 0.0;  ///< mean rotation rate in degrees per microsecond
    /// sector in which the sensor never fires, for sensors that can fire at any azimuth
    SkippedSector skipped_;
    /// Histogram of the intensities, indexed by 255 x intensity. Empty if intensities
    /// cannot exceed 1.
    std::vector<std::uint32_t> n_bright_;

    void check_product(const PacketView& packet, const Calibration& calibration);
    void add_packet(const PacketView& view, std::uint16_t in_message);
    void unwrap_clock(Entry& entry) const;
    void count_max_intensities(const Packet& packet);
    double step_deg() const;
    std::pair<double, double> find_azimuth_reach_deg() const;
    std::vector<bool> find_lost_columns(const PacketTurn& turn) const;
    Scan arrange_points(const PacketTurn& turn, FiredPoints& fired, const SpinningSensor& sensor) const;
    int compute_column(const PacketTurn& turn, double azimuth_deg) const;
    void find_revolutions();
    std::size_t count_steps_to(std::size_t packet) const;
    double count_lost_slots(std::size_t packet) const;
    std::size_t count_missing_before(std::size_t packet) const;
    void count_missing(PacketTurn& turn) const;
    bool is_evenly_sampled(const PacketTurn& turn) const;
    void compute_turn_times(PacketTurn& turn) const;
    double compute_slot_deg(const PacketTurn& turn) const;
    std::uint32_t find_first_message(const PacketTurn& turn) const;
    double find_max_intensity() const;
    double intensity_max() const;
    Packet reread_packet(std::size_t message, const Entry& entry,
                         const std::vector<std::vector<PacketView>>& packets) const;
};

}  // namespace relidar::packets
