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

/// A file of the page. A client receives it if the client requests exactly this path.
struct Asset {
    std::string_view path;  ///< Path in the URL, such as "/main.js". The path "/" is the page.
    std::string_view type;  ///< Value of the header Content-Type.
    std::string_view body;
};

struct ServerOptions {
    std::string address = "127.0.0.1";  ///< Literal IPv4 or IPv6 address to listen on.
    int port = 8080;                    ///< Port to listen on. 0 selects a free port.
    /// Access token that every request must contain. If it is empty, no token is needed.
    std::string token = {};
    std::span<const Asset> assets = {};
    std::size_t max_connections = 64;
    std::size_t max_header_bytes = 8192;
    /// Maximum size of a WebSocket message from a client, in bytes.
    std::size_t max_message_bytes = std::size_t(1) << 20;
    std::chrono::milliseconds request_time{5000};  ///< Maximum time to receive a complete request.
    /// A WebSocket is closed if its client does not answer a ping within this time.
    std::chrono::milliseconds idle_time{30000};
};

/// Path of the WebSocket.
inline constexpr std::string_view kSocketPath = "/live";

/// Identifies one open WebSocket during its lifetime.
using ClientId = std::uint64_t;

/// Callbacks for events of WebSocket clients. They run on the thread of the server, one
/// at a time. They must not throw.
struct Events {
    std::function<void(ClientId)> opened;
    /// Called for each text message of a client. Its size is at most max_message_bytes.
    /// Binary messages are refused.
    std::function<void(ClientId, std::string)> message;
    std::function<void(ClientId)> closed;
};

class Server {
public:
    /// Starts to listen and to answer requests.
    /// @throws UsageError if the address or the port is not available
    Server(const ServerOptions& options, Events events);
    /// Closes all connections immediately. Call close() first to send the queued
    /// messages.
    ~Server();
    Server(const Server&) = delete;
    Server& operator=(const Server&) = delete;

    int port() const;
    /// Returns the URL of the page for a browser on this machine. It includes the access
    /// token.
    std::string url() const;

    /// Sends a text to a client. Does nothing if the client has disconnected. Any thread
    /// may call it.
    void send_text(ClientId client, std::string text);
    /// Sends a binary message to a client. If an earlier binary message is still queued,
    /// it is replaced, because only the newest scan matters.
    void send_newest(ClientId client, std::string bytes);
    /// Rejects new connections. Closes each WebSocket after its queued messages were
    /// sent.
    /// @param patience longest time to wait until the messages are sent
    void close(std::chrono::milliseconds patience);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Checks the address at which the server will listen.
/// @throws UsageError if the text is not an IP address
void check_address(const std::string& address);

/// Returns a random secret of 32 hexadecimal digits.
std::string random_token();

}  // namespace relidar::view
