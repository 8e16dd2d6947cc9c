// SPDX-License-Identifier: Apache-2.0
// State that all connections of a server share: options, clients, and the io_context of
// the server's thread. Only the server includes this header.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>

#include "server.hpp"

namespace relidar::view {

class SocketSession;

struct Hub {
    ServerOptions options;
    Events events;
    /// Name of the cookie that holds the access token. Each server has another name,
    /// because a browser sends the cookies of a host to all ports of this host.
    std::string cookie_name;
    std::string host_name;  ///< Name of this machine.
    std::size_t n_connections = 0;
    boost::asio::io_context io{1};
    std::map<ClientId, std::weak_ptr<SocketSession>> clients = {};
    ClientId last_client = 0;
};

/// Counts open connections. The constructor adds one connection, the destructor subtracts
/// it.
class Counted {
public:
    explicit Counted(Hub& hub) : hub_(&hub) { ++hub.n_connections; }
    Counted(Counted&& other) noexcept : hub_(std::exchange(other.hub_, nullptr)) {}
    ~Counted() {
        if (hub_) --hub_->n_connections;
    }
    Counted(const Counted&) = delete;
    Counted& operator=(const Counted&) = delete;
    Counted& operator=(Counted&&) = delete;

private:
    Hub* hub_;
};

}  // namespace relidar::view
