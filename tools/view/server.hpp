// SPDX-License-Identifier: Apache-2.0
// A small HTTP and WebSocket server for one page: it serves what is in its table of
// assets, and text and binary messages on one WebSocket. It knows nothing of LiDAR and
// never opens a file. Who may connect:
//   - on a loopback address everybody on this machine; elsewhere whoever shows the token, in the URL's query once, then as a cookie;
//   - by an address, "localhost" or this machine's own name: another name may be anybody's DNS (rebinding);
//   - from the page itself: an Origin that is not this server is refused.
// All is bounded: connections, header and message bytes, time for a request, messages
// that wait for a slow reader.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>

namespace relidar::view {

/// One thing that can be asked for by its exact name.
struct Asset {
    std::string_view path;  ///< "/main.js"; "/" is the page
    std::string_view type;  ///< Content-Type
    std::string_view body;
};

struct ServerOptions {
    std::string address = "127.0.0.1";  ///< to listen on, a literal IPv4 or IPv6 address
    int port = 8080;                    ///< 0: any that is free
    std::string token = {};             ///< every request has to show it; empty: none needed
    std::span<const Asset> assets = {};
    std::size_t max_connections = 64;
    std::size_t max_header_bytes = 8192;
    std::size_t max_message_bytes = std::size_t(1) << 20;  ///< of one WebSocket message to the server
    std::chrono::milliseconds request_time{5000};          ///< in which a request has to be complete
    std::chrono::milliseconds idle_time{30000};  ///< after which a WebSocket that answers no ping is closed
};

/// Path of the WebSocket.
inline constexpr std::string_view kSocketPath = "/live";

/// One open WebSocket, for as long as it lives.
using ClientId = std::uint64_t;

/// What happens on WebSockets. Called on the server's own thread, one at a time; what
/// they throw is a bug.
struct Events {
    std::function<void(ClientId)> opened;
    /// a text of at most max_message_bytes; binary ones are refused
    std::function<void(ClientId, std::string)> message;
    std::function<void(ClientId)> closed;
};

class Server {
public:
    /// Listens and answers from now on. @throws UsageError for an address or port that
    /// cannot be had
    Server(const ServerOptions& options, Events events);
    /// Closes every connection at once; close() before it does so in order.
    ~Server();
    Server(const Server&) = delete;
    Server& operator=(const Server&) = delete;

    int port() const;
    /// Where a browser on this machine finds the page, token included.
    std::string url() const;

    /// Any thread may send; nothing happens where the client has gone.
    void send_text(ClientId client, std::string text);
    /// Where an earlier one still waits to be sent, this one takes its place: of pictures
    /// only the newest matters.
    void send_newest(ClientId client, std::string bytes);
    /// Lets nobody in any more, and closes each WebSocket once what waits for it has been
    /// sent. Waits for that, for so long at most.
    void close(std::chrono::milliseconds patience);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// @throws UsageError where it is no literal address, as ServerOptions::address must be
void check_address(const std::string& address);

/// A secret that nobody guesses: 32 hexadecimal digits.
std::string random_token();

}  // namespace relidar::view
