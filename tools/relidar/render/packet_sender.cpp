// SPDX-License-Identifier: Apache-2.0
#include "render/packet_sender.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <thread>

#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_packets.hpp>
#include "../network/host_port.hpp"
#include "base/fail.hpp"
#include "interrupt.hpp"

namespace relidar::cli {
namespace {

using Clock = std::chrono::steady_clock;

/// UDP socket that is connected to an address.
class UdpSocket {
public:
    explicit UdpSocket(const HostPort& address) {
        addrinfo hints{}, *addresses = nullptr;
        hints.ai_socktype = SOCK_DGRAM;
        const std::string port = fmt::format("{}", address.port);
        if (const int error = ::getaddrinfo(address.host.c_str(), port.c_str(), &hints, &addresses);
            error != 0)
            fail<UsageError>(
                "cannot send packets to the host {} (--udp): {}; expected the name or IP address of a "
                "reachable host",
                address.host, ::gai_strerror(error));
        socket_ = ::socket(addresses->ai_family, addresses->ai_socktype, addresses->ai_protocol);
        const int on = 1;
        (void)::setsockopt(socket_, SOL_SOCKET, SO_BROADCAST, &on, sizeof on);
        const bool is_connected =
            socket_ >= 0 && ::connect(socket_, addresses->ai_addr, addresses->ai_addrlen) == 0;
        const std::string why = std::strerror(errno);
        ::freeaddrinfo(addresses);
        if (!is_connected && socket_ >= 0) ::close(socket_);
        if (!is_connected) fail("cannot send packets to {}:{} (--udp): {}", address.host, address.port, why);
    }
    UdpSocket(UdpSocket&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
    ~UdpSocket() {
        if (socket_ >= 0) ::close(socket_);
    }

    void send_datagram(const std::string& bytes) {
        // ECONNREFUSED means that nobody received an earlier packet. The current packet
        // was not sent in this case, so it is sent again.
        if (::send(socket_, bytes.data(), bytes.size(), 0) < 0 && errno == ECONNREFUSED)
            (void)::send(socket_, bytes.data(), bytes.size(), 0);
    }

private:
    int socket_ = -1;
};

struct QueuedPacket {
    std::size_t sensor;
    SensorPacket packet;
};

}  // namespace

void add_packet_destination_options(CLI::App& command, PacketDestination& parsed_destination,
                                    const std::string& udp_help_text, const std::string& realtime_help_text) {
    command.add_option("--udp", parsed_destination.address, udp_help_text)->type_name("HOST:PORT");
    command.add_flag("--realtime", parsed_destination.is_realtime, "with --udp: " + realtime_help_text);
}

void require_valid_packet_destination(const PacketDestination& destination) {
    if (!destination.address.empty()) (void)parse_host_port(destination.address, "--udp", 1);
    else if (destination.is_realtime)
        throw UsageError("--realtime can only be used with --udp HOST:PORT, the address of the receiver");
}

void require_valid_packet_options(const PacketDestination& destination,
                                  const std::vector<std::string>& output_file_formats,
                                  bool is_merging_sensor_scans, int n_processes) {
    if (!destination.address.empty() && n_processes > 1)
        fail<UsageError>(
            "--udp: found {} MPI processes; expected one, because a single process sends the packets",
            n_processes);
    const bool writes_packets = !destination.address.empty() ||
                                std::ranges::find(output_file_formats, "pcap") != output_file_formats.end();
    if (writes_packets && is_merging_sensor_scans)
        throw UsageError(
            "--merge: found --udp or --format pcap; expected neither, because packets hold the scan of a "
            "single sensor");
    require_valid_packet_destination(destination);
}

struct PacketQueue::Impl {
    std::vector<UdpSocket> sockets;
    std::vector<QueuedPacket> queue;
    std::size_t n_sent = 0;
    bool is_realtime, is_interruptible;
};

PacketQueue::PacketQueue(const PacketDestination& target, std::size_t n_sensors)
    : impl_(new Impl{{}, {}, 0, target.is_realtime, target.is_interruptible}) {
    HostPort address = parse_host_port(target.address, "--udp", 1);
    for (std::size_t s = 0; s < n_sensors; ++s, ++address.port) impl_->sockets.emplace_back(address);
}

PacketQueue::~PacketQueue() = default;

void PacketQueue::send_or_queue_packets(std::vector<std::vector<SensorPacket>> packets_by_sensor) {
    for (std::size_t s = 0; s < packets_by_sensor.size(); ++s)
        for (SensorPacket& packet : packets_by_sensor[s]) impl_->queue.push_back({s, std::move(packet)});
    if (!impl_->is_realtime) send_queued_packets();
}

void PacketQueue::send_queued_packets() {
    std::ranges::stable_sort(impl_->queue, {},
                             [](const QueuedPacket& queued) { return queued.packet.time_ns; });
    const Clock::time_point start = Clock::now();
    for (const auto& [sensor, packet] : impl_->queue) {
        const std::int64_t after_ns = packet.time_ns - impl_->queue.front().packet.time_ns;
        if (impl_->is_realtime) std::this_thread::sleep_until(start + std::chrono::nanoseconds(after_ns));
        if (impl_->is_interruptible) throw_if_interrupted();
        impl_->sockets[sensor].send_datagram(packet.bytes);
        ++impl_->n_sent;
    }
    impl_->queue.clear();
}

std::size_t PacketQueue::get_sent_packet_count() const { return impl_->n_sent; }

struct PacketSender::Impl {
    ScanPacketEncoder packets;
    PacketQueue queue;
};

PacketSender::PacketSender(const PacketDestination& target, const std::vector<ScanOutputOptions>& sensors)
    : impl_(new Impl{ScanPacketEncoder(sensors), PacketQueue(target, sensors.size())}) {}

PacketSender::~PacketSender() = default;

void PacketSender::send_or_queue_scans(std::span<const RenderedScan> scans) {
    impl_->queue.send_or_queue_packets(impl_->packets.encode_scans_as_packets(scans));
}

void PacketSender::send_queued_packets() { impl_->queue.send_queued_packets(); }

std::string PacketSender::send_remaining_packets_and_describe_result() {
    impl_->queue.send_or_queue_packets(impl_->packets.flush_remaining_packets());
    impl_->queue.send_queued_packets();
    return fmt::format("{} packets sent by UDP\n", impl_->queue.get_sent_packet_count());
}

}  // namespace relidar::cli
