// SPDX-License-Identifier: Apache-2.0
// Groups the packets of a spinning LiDAR into sweeps. Supports all products for which
// relidar has a decoder.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <relidar/read/clouds.hpp>

#include "read/files/recording.hpp"
#include "read/packets/decoder.hpp"

namespace relidar::packets {

// Functions of packet_order.cpp. They sort the packets of a LiDAR in the order of
// sending, because a network may deliver packets late or twice.

/// A packet in the index of a recording. If the sensor skips a sector within a packet,
/// the packet has two entries, one for each side of the sector.
struct PacketIndexEntry {
    /// Time of the first firing: `stamp_ns` by the receiver's clock, `clock_ns` by the
    /// sensor's clock. If the sensor's clock restarts at 0, `clock_ns` continues.
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
    std::uint32_t n_lost_before = 0;  ///< number of packets that were lost since the previous entry
};

/// Returns the angle by which the head turns from one azimuth to the next, below 360
/// degrees. Negative if encoder noise makes the next azimuth slightly smaller.
double rotation_deg(double from_azimuth_deg, double to_azimuth_deg);

/// Number of packets that were received twice, or after packets that were sent later.
struct PacketFaultCounts {
    std::size_t n_repeated = 0, n_late = 0;
};
/// Sorts packets by the sensor's clock and removes repeated packets. Does not move a
/// packet whose time is much earlier, because its clock was set back.
PacketFaultCounts sort_packets(std::vector<PacketIndexEntry>& packets);

/// Makes the azimuths continuous, without jumps at 360 degrees. Also adds the pause to
/// the times of packets during which the head passes a sector without firings.
/// @return mean rotation rate in degrees per microsecond
double unwrap_azimuths(std::vector<PacketIndexEntry>& packets, const FiringTiming& timing);

/// Azimuth sector in which the sensor never fires.
struct SkippedSector {
    double begin_deg = 0.0, width_deg = 0.0;  ///< width 0: no such sector

    /// Returns how many degrees between two azimuths, which count over all revolutions,
    /// are in this sector.
    double overlap_deg(double from_deg, double to_deg) const;
};
/// Finds the azimuth sector in which the sensor never fires. The sector must occur in at
/// least two revolutions, because a gap in one revolution can be packet loss.
/// @param firing_step_deg  azimuth step between two firings
SkippedSector find_skipped_sector(const std::vector<PacketIndexEntry>& packets, double firing_step_deg);

struct RevolutionPoints;

/// One revolution of the LiDAR's head. It begins and ends when the head faces backward.
struct PacketRevolution {
    /// `forward_ns`: time at which the head faces forward. `log_ns`: time at which the
    /// recorder received the packet that was sent then.
    std::int64_t forward_ns = 0, log_ns = 0;
    std::size_t first = 0, last = 0;  ///< packets of the revolution
    /// Head angle at the start, continuous over the full recording.
    double begin_deg = 0.0;
    /// number of lost packets, including those at the start and the end of the revolution
    std::size_t n_missing = 0;
    bool has_gaps = false;  ///< true if packets of the revolution were lost, at least in part
    /// Time stamp minus sensor clock, for the packet with the least network delay. If the
    /// sensor's clock does not define the times, for the packet at `forward_ns`.
    std::int64_t stamp_less_clock_ns = 0;
};

/// Index of the LiDAR packets of a topic: time, head angle and message of each packet.
class PacketIndex {
public:
    /// Adds the packets of one message.
    /// @throws DataError if packets of the product cannot be decoded, or if earlier
    /// packets came from another product
    void add_packets(const std::vector<ReceivedPacket>& packets, std::int64_t recording_time_ns,
                     const MessagePosition& message_position, const DecoderCalibration& calibration);
    /// Sorts the packets and finds the complete revolutions. Call it once, at the end.
    void finish();
    bool empty() const { return packets_.empty(); }
    std::size_t size() const { return n_packets_; }
    const std::vector<PacketRevolution>& revolutions() const { return revolutions_; }
    /// Returns true if the sensor's clock restarts after a fixed time, such as an hour.
    bool has_clock_wraps() const { return decoder_ && decoder_->timing().wrap_us > 0.0; }
    /// Describes late and repeated packets, and skipped revolutions. May be empty.
    std::string describe_faults() const;
    /// Position of a message in the recording, and time of recording.
    struct MessageSource {
        MessagePosition message_position;
        std::int64_t log_ns;
    };
    /// Returns the range of messages that contains all packets of a revolution.
    std::vector<MessageSource> messages_of(const PacketRevolution& revolution) const;
    /// Returns the sensor model with the measured rotation rate.
    SpinningSensor make_sensor() const;
    std::string describe_product() const;
    /// Decodes a revolution to a scan with ray times relative to `time_origin_ns`.
    /// @param packets_of_message  packets of each message that messages_of() returns
    Scan decode(const PacketRevolution& revolution,
                const std::vector<std::vector<ReceivedPacket>>& packets_of_message,
                const SpinningSensor& sensor, std::int64_t time_origin_ns) const;

private:
    using Entry = PacketIndexEntry;
    /// Number of skipped revolutions by reason.
    struct SkippedRevolutions {
        std::size_t n_cut_off = 0;  ///< incomplete at the start or the end of the recording
        std::size_t n_lost = 0;     ///< at least a third of the packets were lost
        std::size_t n_jumps = 0;    ///< the sensor's clock jumped
    };
    std::shared_ptr<const PacketDecoder> decoder_;
    const LidarProduct* product_ = nullptr;
    DecoderCalibration calibration_;
    int slots_per_packet_ = 1;
    std::size_t n_packets_ = 0;  ///< number of packets without repeats
    std::uint16_t n_empty_ = 0;  ///< packets without a firing since the last one with firings
    std::vector<Entry> packets_;
    std::vector<MessageSource> messages_;
    std::vector<PacketRevolution> revolutions_;
    PacketFaultCounts faults_;
    SkippedRevolutions left_out_;
    double mean_deg_us_ = 0.0;  ///< mean rotation rate in degrees per microsecond
    /// sector in which the sensor never fires, although it could fire at any azimuth
    SkippedSector skipped_sector_;
    /// Number of returns by intensity in units of 1/255, up to the highest intensity of
    /// all packets. Used only for sensors whose intensities can exceed 1.
    std::vector<std::uint32_t> n_returns_of_bin_;

    void set_product(const std::vector<ReceivedPacket>& packets, DecoderCalibration calibration);
    void index_packet(const ReceivedPacket& packet_view, std::uint16_t index_in_message);
    void unwrap_clock(Entry& entry) const;
    void count_intensities(const DecodedPacket& packet);
    double firing_step_deg() const;
    std::int64_t column_at(double azimuth_deg) const;
    std::int64_t first_column(const Entry& packet) const;
    int column_in(const PacketRevolution& revolution, double azimuth_deg) const;
    std::pair<double, double> azimuth_range_deg() const;
    std::vector<bool> find_lost_columns(const PacketRevolution& revolution) const;
    Scan make_scan(const PacketRevolution& revolution, RevolutionPoints& fired,
                   const SpinningSensor& sensor) const;
    std::size_t packet_behind(double azimuth_deg) const;
    PacketRevolution make_revolution(double begin_deg) const;
    void find_revolutions();
    void keep_if_usable(PacketRevolution revolution);
    std::uint32_t count_lost_by_time(const Entry& before, const Entry& entry) const;
    std::uint32_t count_lost_by_column(const Entry& before, const Entry& entry) const;
    void store_lost_packets(PacketRevolution& revolution) const;
    bool has_steady_clock(const PacketRevolution& revolution) const;
    void set_times(PacketRevolution& revolution) const;
    double mean_step_deg(const PacketRevolution& revolution) const;
    std::pair<std::uint32_t, std::uint32_t> message_range(const PacketRevolution& revolution) const;
    double full_scale() const;
    DecodedPacket decode_entry(std::size_t message_index, const Entry& packet_entry,
                               const std::vector<std::vector<ReceivedPacket>>& packets_of_message) const;
};

}  // namespace relidar::packets
