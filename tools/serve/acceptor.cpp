// SPDX-License-Identifier: Apache-2.0
#include "acceptor.hpp"

#include <algorithm>
#include <chrono>

#include <sys/resource.h>
#include <unistd.h>
#include <boost/asio/ip/v6_only.hpp>

#include "base/fail.hpp"

#include "../network/host_port.hpp"

namespace relidar::serve {
namespace {

using boost::asio::ip::tcp;
using ErrorCode = boost::system::error_code;

constexpr std::chrono::milliseconds kRetryPause{50};
// Maximum number of open file descriptors of the process. Connections count too.
constexpr int kMostDescriptors = 16384;
constexpr int kReservedDescriptors = 256;

[[noreturn]] void fail_listen(const std::string& address, const std::string& reason) {
    fail<UsageError>("cannot listen at {}: {}; use a free HOST:PORT of this machine", address, reason);
}

/// Opens a socket that listens at one address.
/// @param failed output: the error if this is not possible
tcp::acceptor open_listener(boost::asio::io_context& io, const tcp::endpoint& endpoint, ErrorCode& failed) {
    tcp::acceptor listener(io);
    listener.open(endpoint.protocol(), failed);
    if (!failed) listener.set_option(tcp::acceptor::reuse_address(true), failed);
    // Accepted connections inherit this option.
    if (!failed) listener.set_option(tcp::no_delay(true), failed);
    // An IPv6 socket that listens at [::] also accepts IPv4 connections.
    if (!failed && endpoint.address().is_v6()) listener.set_option(boost::asio::ip::v6_only(false), failed);
    if (!failed) listener.bind(endpoint, failed);
    if (!failed) listener.listen(tcp::acceptor::max_listen_connections, failed);
    return listener;
}

/// Returns true if too few file descriptors are left for other purposes. The system
/// always assigns the lowest free number, so a high number means that many are open.
bool is_too_high(int descriptor) {
    rlimit limit{};
    const bool has_usable_limit =
        ::getrlimit(RLIMIT_NOFILE, &limit) == 0 && limit.rlim_cur < rlim_t(kMostDescriptors);
    const int most_descriptors = has_usable_limit ? int(limit.rlim_cur) : kMostDescriptors;
    return descriptor >= most_descriptors - std::min(kReservedDescriptors, most_descriptors / 4);
}

}  // namespace

/// Opens a socket for each address of the host. A name such as localhost has an IPv4 and
/// an IPv6 address, and at least one must work.
Acceptor::Acceptor(const std::string& text) {
    const HostPort host_port = parse_host_port(text, "--listen", 0);
    ErrorCode failed;
    const auto addresses = tcp::resolver(io_).resolve(host_port.host, "", tcp::resolver::passive, failed);
    if (failed) fail_listen(text, failed.message());
    port_ = host_port.port;  // If it is 0, the first socket selects the port of all.
    for (const auto& entry : addresses) {
        ErrorCode error;
        const tcp::endpoint endpoint(entry.endpoint().address(), std::uint16_t(port_));
        tcp::acceptor listener = open_listener(io_, endpoint, error);
        if (error == boost::asio::error::address_in_use && host_port.port != 0)
            fail_listen(text, "another process already uses it");
        if (error) {  // The machine may not support this address family (IPv4 or IPv6).
            failed = error;
            continue;
        }
        port_ = listener.local_endpoint().port();
        listeners_.push_back(std::move(listener));
    }
    if (listeners_.empty()) fail_listen(text, failed.message());
}

Acceptor::~Acceptor() { stop(); }

void Acceptor::start_accepting(ConnectionCallback handle_connection) {
    receive_ = std::move(handle_connection);
    for (tcp::acceptor& listener : listeners_) accept_next(listener);
    thread_ = std::thread([this] { io_.run(); });
}

/// Waits until a running callback has returned. Closes the listening sockets, so that the
/// system refuses new connections.
void Acceptor::stop() {
    io_.stop();
    if (thread_.joinable()) thread_.join();
    listeners_.clear();
}

/// Accepts a connection, passes it on, and waits for the next one.
void Acceptor::accept_next(tcp::acceptor& listener) {
    listener.async_accept([this, &listener](ErrorCode failed, tcp::socket connection) {
        if (failed) {
            // For example, no file descriptor is free. Tries again later.
            std::this_thread::sleep_for(kRetryPause);
        } else if (is_too_high(connection.native_handle())) {
            connection.close(failed);  // Keeps descriptors free for files and running calls.
        } else {
            connection.native_non_blocking(true, failed);  // gRPC expects this mode.
            receive_(listener.native_handle(), connection.release());
        }
        accept_next(listener);
    });
}

}  // namespace relidar::serve
