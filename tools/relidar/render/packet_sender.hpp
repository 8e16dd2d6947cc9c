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
struct ScanFormat;
}  // namespace relidar

namespace relidar::cli {

struct PacketTarget {
    /// Address HOST:PORT of the receiver. If it is empty, no packets are sent. With
    /// several sensors, the first sensor uses this port and the others use the following
    /// ports.
    std::string address;
    /// If true, packets are queued and then sent with the same time intervals as a real
    /// sensor. If false, each packet is sent as soon as it is complete.
    bool is_realtime = false;
    /// If false, Ctrl-C does not stop the sending, because the caller finishes its work.
    bool is_interruptible = true;
};
/// @param receiver  help text for --udp
/// @param pace  help text for --realtime
void add_packet_options(CLI::App& command, PacketTarget& target, const std::string& receiver,
                        const std::string& pace);
/// @throws UsageError if the address is invalid, or --realtime is used without --udp
void check_packet_target(const PacketTarget& target);
/// Checks the options for sending packets of rendered scans.
/// @param formats  formats of the output files
/// @param merges  true if the scans of all sensors are merged into one
/// @param n_processes  number of MPI processes
/// @throws UsageError in the same cases as check_packet_target(). Also if merged scans
/// should be written as packets, or several processes should send packets.
void check_packet_options(const PacketTarget& target, const std::vector<std::string>& formats, bool merges,
                          int n_processes);

/// Sends packets to a UDP socket per sensor.
class PacketQueue {
public:
    /// Opens the sockets.
    /// @throws UsageError if the host is unknown
    PacketQueue(const PacketTarget& target, std::size_t n_sensors);
    ~PacketQueue();

    /// Sends packets, or stores them until send_all() sends them.
    /// @param packets  [sensors]
    void add(std::vector<std::vector<SensorPacket>> packets);
    /// Sends the stored packets with the timing of the sensor.
    void send_all();
    std::size_t n_sent() const;

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
    PacketSender(const PacketTarget& target, const std::vector<ScanFormat>& sensors);
    ~PacketSender();

    /// Sends the packets of one sweep, or stores them until send_all() or finish() sends
    /// them.
    /// @param scans  one scan for each sensor
    void add(std::span<const RenderedScan> scans);
    /// Sends the stored packets with the timing of the sensor.
    void send_all();
    /// Sends the remaining packets.
    /// @return a line that tells the user how many packets were sent
    std::string finish();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::cli
