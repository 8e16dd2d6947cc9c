// SPDX-License-Identifier: Apache-2.0
// Reads the options --udp and --realtime, and sends the network packets of simulated
// sensors to a sensor driver.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include <relidar/log/packets.hpp>

namespace CLI {
class App;
}
namespace relidar {
struct RenderedScan;
struct ScanOutputOptions;
}  // namespace relidar

namespace relidar::cli {

struct PacketDestination {
    /// Address HOST:PORT of the receiver. If it is empty, no packets are sent. With
    /// several sensors, the first sensor uses this port and the others use the following
    /// ports.
    std::string address;
    /// If true, packets are queued and then sent with the same time intervals as a real
    /// sensor. If false, each packet is sent as soon as it is complete.
    bool is_realtime = false;
    /// If true, Ctrl-C stops the sending of packets. `relidar serve` sets this to false,
    /// because it still answers pending calls after Ctrl-C.
    bool is_interruptible = true;
};
/// @param udp_help_text  help text for --udp
/// @param realtime_help_text  help text for --realtime
void add_packet_destination_options(CLI::App& command, PacketDestination& parsed_destination,
                                    const std::string& udp_help_text, const std::string& realtime_help_text);
/// @throws UsageError if the address is invalid, or --realtime is used without --udp
void require_valid_packet_destination(const PacketDestination& destination);
/// Checks the options for sending packets of rendered scans.
/// @param output_file_formats  formats of the output files
/// @param is_merging_sensor_scans  true if the scans of all sensors are merged into one
/// @param n_processes  number of MPI processes
/// @throws UsageError if require_valid_packet_destination() fails, if packets of merged
/// scans are requested, or if several processes would send packets
void require_valid_packet_options(const PacketDestination& destination,
                                  const std::vector<std::string>& output_file_formats,
                                  bool is_merging_sensor_scans, int n_processes);

/// Sends packets to a UDP socket per sensor.
class PacketQueue {
public:
    /// Opens the sockets.
    /// @throws UsageError if the host is unknown
    PacketQueue(const PacketDestination& target, std::size_t n_sensors);
    ~PacketQueue();

    /// Sends packets, or stores them until send_queued_packets() sends them.
    /// @param packets_by_sensor  [sensors]
    void send_or_queue_packets(std::vector<std::vector<SensorPacket>> packets_by_sensor);
    /// Sends the stored packets with the timing of the sensor.
    void send_queued_packets();
    std::size_t get_sent_packet_count() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Sends the packets of rendered scans.
class PacketSender {
public:
    /// Opens a UDP socket to the receiver.
    /// @throws UsageError if the host is unknown, or if relidar cannot write packets of a
    /// sensor
    PacketSender(const PacketDestination& target, const std::vector<ScanOutputOptions>& sensors);
    ~PacketSender();

    /// Sends the packets of one sweep, or stores them until send_queued_packets() or
    /// send_remaining_packets_and_describe_result() sends them.
    /// @param scans  one scan for each sensor
    void send_or_queue_scans(std::span<const RenderedScan> scans);
    /// Sends the stored packets with the timing of the sensor.
    void send_queued_packets();
    /// Sends the remaining packets.
    /// @return a line that tells the user how many packets were sent
    std::string send_remaining_packets_and_describe_result();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::cli
