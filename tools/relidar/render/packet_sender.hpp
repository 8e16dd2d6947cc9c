// SPDX-License-Identifier: Apache-2.0
// Reads the options --udp and --realtime. Sends the packets of rendered sensors to a
// driver.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

namespace CLI {
class App;
}
namespace relidar {
struct RenderedScan;
struct ScanFormat;
}  // namespace relidar

namespace relidar::cli {

struct PacketTarget {
    /// HOST:PORT of the receiver. Empty: nothing is sent. The sensors of a rig send to
    /// this port and the ports after it.
    std::string address;
    /// True: sends the packets after rendering, with the time intervals of the sensor.
    /// False: sends each packet as soon as it is rendered.
    bool is_realtime = false;
};
void add_packet_options(CLI::App& command, PacketTarget& target);
/// Checks the options for packets.
/// @param formats  formats of the output files
/// @param merges  true if the scans of all sensors are merged
/// @param n_processes  number of MPI processes
/// @throws UsageError if the address is invalid, if --realtime is used without --udp, if
/// merged scans should be written as packets, or if several processes should send
void check_packet_options(const PacketTarget& target, const std::vector<std::string>& formats, bool merges,
                          int n_processes);

class PacketSender {
public:
    /// Opens a UDP socket.
    /// @throws UsageError if the host is unknown or packets of a sensor cannot be written
    PacketSender(const PacketTarget& target, const std::vector<ScanFormat>& sensors);
    ~PacketSender();

    /// Sends the packets of a sweep, or stores them until finish().
    /// @param scans  a scan for each sensor
    void add(std::span<const RenderedScan> scans);
    /// Sends the remaining packets.
    /// @return a line for the user
    std::string finish();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::cli
