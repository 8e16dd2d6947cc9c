// SPDX-License-Identifier: Apache-2.0
// A small HTTP and WebSocket server for one page. It serves a fixed table of assets, and
// text and binary messages on one WebSocket. It does not depend on LiDAR code and never
// opens a file. Rules of access:
// - On a loopback address, every user of this machine has access. On other addresses,
//   clients must present the token: once in the URL, then as a cookie.
// - The Host header must be an IP address, "localhost" or the name of this machine,
//   because other names allow DNS rebinding.
// - Requests whose Origin is not this server are refused.
//
// All resources are bounded: connections, bytes of headers and messages, time for a
// request, and messages queued for a slow client.
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

/// A file of the page. Clients request it by its exact path.
struct Asset {
    std::string_view path;  ///< Path such as "/main.js". "/" is the page itself.
    std::string_view type;  ///< Value of the header Content-Type.
    std::string_view body;
};

struct ServerOptions {
    std::string address = "127.0.0.1";  ///< Literal IPv4 or IPv6 address to listen on.
    int port = 8080;                    ///< 0: any free port.
    std::string token = {};  ///< Secret that every request must present. Empty: no token is needed.
    std::span<const Asset> assets = {};
    std::size_t max_connections = 64;
    std::size_t max_header_bytes = 8192;
    /// Maximum size of a WebSocket message from a client.
    std::size_t max_message_bytes = std::size_t(1) << 20;
    std::chrono::milliseconds request_time{5000};  ///< Maximum time until a request is complete.
    /// A WebSocket that answers no ping for this time is closed.
    std::chrono::milliseconds idle_time{30000};
};

/// Path of the WebSocket.
inline constexpr std::string_view kSocketPath = "/live";

/// Identifies one open WebSocket during its lifetime.
using ClientId = std::uint64_t;

/// Callbacks for WebSocket events. They run on the server's thread, one at a time, and
/// must not throw.
struct Events {
    std::function<void(ClientId)> opened;
    /// Receives a text of at most max_message_bytes. Binary messages are refused.
    std::function<void(ClientId, std::string)> message;
    std::function<void(ClientId)> closed;
};

class Server {
public:
    /// Starts to listen and to answer requests.
    /// @throws UsageError if the address or port is not available
    Server(const ServerOptions& options, Events events);
    /// Closes every connection immediately. Call close() first for an orderly shutdown.
    ~Server();
    Server(const Server&) = delete;
    Server& operator=(const Server&) = delete;

    int port() const;
    /// Returns the URL of the page for a browser on this machine, including the token.
    std::string url() const;

    /// Sends a text. May be called from any thread. Does nothing if the client has
    /// disconnected.
    void send_text(ClientId client, std::string text);
    /// Sends a binary message and replaces an earlier one that is still queued, because
    /// only the newest picture matters.
    void send_newest(ClientId client, std::string bytes);
    /// Rejects new connections, and closes each WebSocket after its queued messages were
    /// sent.
    /// @param patience longest time to wait for this
    void close(std::chrono::milliseconds patience);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Checks the address that the server listens on.
/// @throws UsageError if the text is not a literal IP address, as ServerOptions::address
/// requires
void check_address(const std::string& address);

/// Returns a random secret of 32 hexadecimal digits.
std::string random_token();

}  // namespace relidar::view
