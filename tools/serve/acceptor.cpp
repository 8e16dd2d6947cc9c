// SPDX-License-Identifier: Apache-2.0
#include "acceptor.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <memory>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/fail.hpp"

#include "../network/host_port.hpp"

namespace relidar::serve {
namespace {

constexpr std::chrono::milliseconds kRetryPause{50};
// Maximum number of open file descriptors of the process. Connections count too.
constexpr int kMostDescriptors = 16384;
constexpr int kReservedDescriptors = 256;

[[noreturn]] void fail_listen(const std::string& address, const std::string& reason) {
    fail<UsageError>("cannot listen at {}: {}; use a free HOST:PORT of this machine", address, reason);
}

struct FreeAddresses {
    void operator()(addrinfo* all) const { ::freeaddrinfo(all); }
};
using AddrInfoPtr = std::unique_ptr<addrinfo, FreeAddresses>;

AddrInfoPtr resolve_host(const std::string& host, const std::string& where) {
    addrinfo hints{};
    hints.ai_socktype = SOCK_STREAM;
    hints.ai_flags = AI_PASSIVE;
    addrinfo* all = nullptr;
    if (const int error = ::getaddrinfo(host.c_str(), nullptr, &hints, &all); error != 0)
        fail_listen(where, ::gai_strerror(error));
    return AddrInfoPtr(all);
}

void set_port(sockaddr& address, int port) {
    const auto number = htons(static_cast<std::uint16_t>(port));
    if (address.sa_family == AF_INET6) reinterpret_cast<sockaddr_in6&>(address).sin6_port = number;
    else reinterpret_cast<sockaddr_in&>(address).sin_port = number;
}

int bound_port(int listening_socket) {
    sockaddr_storage storage{};
    socklen_t size = sizeof(storage);
    if (::getsockname(listening_socket, reinterpret_cast<sockaddr*>(&storage), &size) != 0) return 0;
    if (storage.ss_family == AF_INET6) return ntohs(reinterpret_cast<const sockaddr_in6&>(storage).sin6_port);
    return ntohs(reinterpret_cast<const sockaddr_in&>(storage).sin_port);
}

void set_option(int socket, int level, int option_name, int option_value) {
    (void)::setsockopt(socket, level, option_name, &option_value, sizeof(option_value));
}

/// Opens a socket that listens at an address. Returns -1 if this fails; errno then holds
/// the reason.
int open_listener(const addrinfo& address) {
    const int listener = ::socket(address.ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (listener < 0) return -1;
    set_option(listener, SOL_SOCKET, SO_REUSEADDR, 1);
    set_option(listener, IPPROTO_TCP, TCP_NODELAY,
               1);  // Accepted connections inherit this option.
    // An IPv6 socket that listens at [::] also accepts IPv4 connections.
    if (address.ai_family == AF_INET6) set_option(listener, IPPROTO_IPV6, IPV6_V6ONLY, 0);
    if (::bind(listener, address.ai_addr, address.ai_addrlen) == 0 && ::listen(listener, SOMAXCONN) == 0)
        return listener;
    // close() may overwrite errno, but the caller reports the error of bind() or
    // listen().
    const int error = errno;
    ::close(listener);
    errno = error;
    return -1;
}

}  // namespace

/// Listens at all addresses of a host name. If the port is 0, the system selects a port
/// for the first address, and the other addresses use the same port.
Acceptor::Acceptor(const std::string& text) {
    const HostPort host_port = parse_host_port(text, "--listen", 0);
    const AddrInfoPtr all = resolve_host(host_port.host, text);
    int error = EADDRNOTAVAIL;
    port_ = host_port.port;
    for (const addrinfo* address = all.get(); address; address = address->ai_next) {
        set_port(*address->ai_addr, port_);
        const int listener = open_listener(*address);
        if (listener < 0) error = errno;
        if (listener < 0 && error == EADDRINUSE && host_port.port != 0) break;
        // The machine may not support this address family (IPv4 or IPv6).
        if (listener < 0) continue;
        listeners_.push_back(listener);
        port_ = bound_port(listener);
    }
    const bool is_port_in_use = error == EADDRINUSE && host_port.port != 0;
    if (listeners_.empty() || is_port_in_use || ::pipe2(wake_, O_CLOEXEC) != 0) {
        close_listeners();
        fail_listen(text, is_port_in_use ? "another process already uses it"
                                         : std::generic_category().message(error));
    }
}

Acceptor::~Acceptor() {
    stop();
    close_listeners();
}

void Acceptor::close_listeners() {
    for (const int listener : listeners_) ::close(listener);
    listeners_.clear();
    for (int& end : wake_)
        if (end >= 0) ::close(std::exchange(end, -1));
}

void Acceptor::start_accepting(ConnectionCallback handle_connection) {
    receive_ = std::move(handle_connection);
    thread_ = std::thread([this] { run_accept_loop(); });
}

/// Wakes the thread through the pipe and waits until a running callback has returned.
/// Closes the listening sockets, so that the system refuses new connections.
void Acceptor::stop() {
    if (!thread_.joinable()) return;
    const char any = 0;
    while (::write(wake_[1], &any, 1) < 0 && errno == EINTR) {}
    thread_.join();
    for (const int listener : listeners_) ::close(listener);
    listeners_.clear();
}

void Acceptor::run_accept_loop() {
    // Entry 0 is the pipe through which stop() wakes this thread.
    std::vector<pollfd> waits{{wake_[0], POLLIN, 0}};
    for (const int listener : listeners_) waits.push_back({listener, POLLIN, 0});
    while (true) {
        if (::poll(waits.data(), waits.size(), -1) < 0) continue;
        if (waits.front().revents != 0) return;
        for (const pollfd& wait : waits)
            if (wait.revents != 0) accept_one(wait.fd);
    }
}

/// Accepts one connection. Closes it immediately if too few file descriptors are left for
/// other purposes.
void Acceptor::accept_one(int listening_socket) {
    const int connection = ::accept4(listening_socket, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
    const bool is_full =
        connection < 0 && (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM);
    if (is_full) std::this_thread::sleep_for(kRetryPause);
    if (connection < 0) return;
    rlimit limit{};
    const bool has_usable_limit =
        ::getrlimit(RLIMIT_NOFILE, &limit) == 0 && limit.rlim_cur < rlim_t(kMostDescriptors);
    const int most_descriptors = has_usable_limit ? int(limit.rlim_cur) : kMostDescriptors;
    // The system always assigns the lowest free number, so a high number means that many
    // descriptors are open.
    if (connection >= most_descriptors - std::min(kReservedDescriptors, most_descriptors / 4))
        ::close(connection);
    else receive_(listening_socket, connection);
}

}  // namespace relidar::serve
