// SPDX-License-Identifier: Apache-2.0
// Serves one WebSocket connection. Also has the state that all connections of a web
// server share.
#pragma once

#include <deque>
#include <map>
#include <utility>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/websocket/stream.hpp>

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

class SocketSession : public std::enable_shared_from_this<SocketSession> {
public:
    SocketSession(boost::beast::tcp_stream stream, CountedConnection counted, WebServerState& hub);
    /// Upgrades the HTTP connection to a WebSocket. Then registers the client and starts
    /// to read its messages.
    /// @param protocol selected subprotocol of Foxglove; empty for the web page
    void accept_handshake(const boost::beast::http::request<boost::beast::http::empty_body>& upgrade_request,
                          std::string_view protocol);
    void send_message(std::string bytes, bool is_text, bool newest_only);
    /// Skips all of them if earlier messages are still queued.
    void send_batch(std::vector<std::string> messages);
    void drain();

private:
    struct OutgoingMessage {
        std::string bytes;
        bool is_text;
        bool newest_only;
    };
    using Error = boost::system::error_code;

    void read_message();
    void on_read(Error error);
    void write_message();
    void on_write(Error error);
    void close_invalid();
    void close_with_reason(std::uint16_t code, const char* reason);
    void leave_hub();

    WebServerState& hub_;
    CountedConnection counted_;
    boost::beast::websocket::stream<boost::beast::tcp_stream> stream_;
    boost::beast::flat_buffer incoming_;
    std::deque<OutgoingMessage> outgoing_;  ///< Queued messages. The first message is already being written.
    /// id of the client; 0 before the handshake and after the connection is closed
    ClientId id_ = 0;
    bool refused_ = false;
    bool leaving_ = false;
    bool said_goodbye_ = false;
};

}  // namespace relidar::view
