// SPDX-License-Identifier: Apache-2.0
// What the sessions of a server share: its options, its clients, and the one thread's
// io_context. Private to the server.
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
    std::string cookie_name;  ///< of the token; browsers send cookies of one host to all its ports
    std::string own_name;     ///< of this machine
    std::size_t n_connections = 0;
    boost::asio::io_context io{1};
    std::map<ClientId, std::weak_ptr<SocketSession>> clients = {};
    ClientId last_client = 0;
};

/// One of the hub's connections, counted while it lives.
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
