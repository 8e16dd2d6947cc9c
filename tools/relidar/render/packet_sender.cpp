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
#include "interrupt.hpp"

namespace relidar::cli {
namespace {

using Clock = std::chrono::steady_clock;

/// UDP socket that is connected to an address.
class UdpSocket {
public:
    explicit UdpSocket(const HostPort& address) {
        addrinfo hints{}, *found = nullptr;
        hints.ai_socktype = SOCK_DGRAM;
        const std::string port = fmt::format("{}", address.port);
        if (const int error = ::getaddrinfo(address.host.c_str(), port.c_str(), &hints, &found); error != 0)
            throw UsageError(
                fmt::format("--udp {}: {}; expected a reachable host", address.host, ::gai_strerror(error)));
        socket_ = ::socket(found->ai_family, found->ai_socktype, found->ai_protocol);
        const int on = 1;
        (void)::setsockopt(socket_, SOL_SOCKET, SO_BROADCAST, &on, sizeof on);
        const bool is_connected = socket_ >= 0 && ::connect(socket_, found->ai_addr, found->ai_addrlen) == 0;
        const std::string why = std::strerror(errno);
        ::freeaddrinfo(found);
        if (!is_connected && socket_ >= 0) ::close(socket_);
        if (!is_connected) throw DataError(fmt::format("--udp {}:{}: {}", address.host, address.port, why));
    }
    UdpSocket(UdpSocket&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
    ~UdpSocket() {
        if (socket_ >= 0) ::close(socket_);
    }

    void send(const std::string& bytes) {
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

void add_packet_options(CLI::App& command, PacketTarget& target, const std::string& receiver,
                        const std::string& pace) {
    command.add_option("--udp", target.address, receiver)->type_name("HOST:PORT");
    command.add_flag("--realtime", target.is_realtime, "with --udp: " + pace);
}

void check_packet_target(const PacketTarget& target) {
    if (!target.address.empty()) (void)parse_host_port(target.address, "--udp", 1);
    else if (target.is_realtime)
        throw UsageError("--realtime: found no --udp; expected the address of the receiver");
}

void check_packet_options(const PacketTarget& target, const std::vector<std::string>& formats, bool merges,
                          int n_processes) {
    if (!target.address.empty() && n_processes > 1)
        throw UsageError(fmt::format("--udp: found {} MPI processes; expected one", n_processes));
    const bool writes_packets =
        !target.address.empty() || std::ranges::find(formats, "pcap") != formats.end();
    if (writes_packets && merges)
        throw UsageError(
            "--merge: found --udp or --format pcap; expected neither, because packets hold the "
            "scan of a single sensor");
    check_packet_target(target);
}

struct PacketQueue::Impl {
    std::vector<UdpSocket> sockets;
    std::vector<QueuedPacket> queue;
    std::size_t n_sent = 0;
    bool is_realtime, is_interruptible;
};

PacketQueue::PacketQueue(const PacketTarget& target, std::size_t n_sensors)
    : impl_(new Impl{{}, {}, 0, target.is_realtime, target.is_interruptible}) {
    HostPort address = parse_host_port(target.address, "--udp", 1);
    for (std::size_t s = 0; s < n_sensors; ++s, ++address.port) impl_->sockets.emplace_back(address);
}

PacketQueue::~PacketQueue() = default;

void PacketQueue::add(std::vector<std::vector<SensorPacket>> packets) {
    for (std::size_t s = 0; s < packets.size(); ++s)
        for (SensorPacket& packet : packets[s]) impl_->queue.push_back({s, std::move(packet)});
    if (!impl_->is_realtime) send_all();
}

void PacketQueue::send_all() {
    std::ranges::stable_sort(impl_->queue, {},
                             [](const QueuedPacket& queued) { return queued.packet.time_ns; });
    const Clock::time_point start = Clock::now();
    for (const auto& [sensor, packet] : impl_->queue) {
        const std::int64_t after_ns = packet.time_ns - impl_->queue.front().packet.time_ns;
        if (impl_->is_realtime) std::this_thread::sleep_until(start + std::chrono::nanoseconds(after_ns));
        if (impl_->is_interruptible) stop_if_interrupted();
        impl_->sockets[sensor].send(packet.bytes);
        ++impl_->n_sent;
    }
    impl_->queue.clear();
}

std::size_t PacketQueue::n_sent() const { return impl_->n_sent; }

struct PacketSender::Impl {
    ScanPackets packets;
    PacketQueue queue;
};

PacketSender::PacketSender(const PacketTarget& target, const std::vector<ScanFormat>& sensors)
    : impl_(new Impl{ScanPackets(sensors), PacketQueue(target, sensors.size())}) {}

PacketSender::~PacketSender() = default;

void PacketSender::add(std::span<const RenderedScan> scans) {
    impl_->queue.add(impl_->packets.encode(scans));
}

void PacketSender::send_all() { impl_->queue.send_all(); }

std::string PacketSender::finish() {
    impl_->queue.add(impl_->packets.finish());
    impl_->queue.send_all();
    return fmt::format("{} packets sent\n", impl_->queue.n_sent());
}

}  // namespace relidar::cli
