// SPDX-License-Identifier: Apache-2.0
// State that all connections of a web server share.
#pragma once

#include <map>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>

#include "server.hpp"

namespace relidar::view {

class SocketSession;

struct WebServerState {
    WebServerOptions options;
    WebSocketEvents events;
    /// A browser sends all cookies of a host to every port of this host.
    std::string cookie_name;
    std::string host_name;  ///< Name of this machine.
    std::size_t n_connections = 0;
    boost::asio::io_context io{1};
    std::map<ClientId, std::weak_ptr<SocketSession>> clients = {};
    ClientId last_client = 0;
};

class CountedConnection {
public:
    explicit CountedConnection(WebServerState& hub) : hub_(&hub) { ++hub.n_connections; }
    CountedConnection(CountedConnection&& other) noexcept : hub_(std::exchange(other.hub_, nullptr)) {}
    ~CountedConnection() {
        if (hub_) --hub_->n_connections;
    }
    CountedConnection(const CountedConnection&) = delete;
    CountedConnection& operator=(const CountedConnection&) = delete;
    CountedConnection& operator=(CountedConnection&&) = delete;

private:
    WebServerState* hub_;
};

}  // namespace relidar::view
