// SPDX-License-Identifier: Apache-2.0
// A small HTTP and WebSocket server for one web page. It serves a fixed list of files
// from memory, and exchanges text and binary messages on one WebSocket. It does not
// depend on LiDAR code and never opens a file. Access rules:
// - On a loopback address, every user of this machine has access. On other addresses,
//   clients must send the access token: first in the URL, then as a cookie.
// - The Host header must be an IP address, "localhost" or the name of this machine,
//   because other names allow DNS rebinding.
// - Requests whose Origin header names another server are rejected. Foxglove may connect
//   from the origins of is_foxglove_origin(), and from any origin with the token in the URL.
//
// All resources are limited: connections, bytes of headers and messages, time for a
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
#include <vector>

namespace relidar::view {

struct WebPageFile {
    std::string path;       ///< Path in the URL, such as "/main.js". The path "/" is the start page.
    std::string_view type;  ///< Value of the header Content-Type.
    std::string_view body;
};

/// Files of the web page, compiled into the program.
const std::vector<WebPageFile>& web_page_files();

struct WebServerOptions {
    std::string address = "127.0.0.1";  ///< Literal IPv4 or IPv6 address to listen on.
    int port = 8080;                    ///< TCP port to listen on. The value 0 selects a free port.
    /// Every request must contain it. Empty: no token is needed.
    std::string token = {};
    std::span<const WebPageFile> assets = {};
    std::size_t max_connections = 64;
    std::size_t max_header_bytes = 8192;
    std::size_t max_message_bytes = std::size_t(1) << 20;
    std::chrono::milliseconds request_time{5000};
    /// In which a client must answer a ping. Then its WebSocket is closed.
    std::chrono::milliseconds idle_time{30000};
};

inline constexpr std::string_view kSocketPath = "/live";
/// Subprotocols with the same messages, also at the path "/".
inline constexpr std::string_view kFoxgloveProtocols[] = {"foxglove.websocket.v1", "foxglove.sdk.v1"};

using ClientId = std::uint64_t;

/// The server's thread calls them one at a time. They must not throw exceptions.
struct WebSocketEvents {
    std::function<void(ClientId)> opened;
    /// At most max_message_bytes bytes. Binary messages are rejected.
    std::function<void(ClientId, std::string)> message;
    std::function<void(ClientId)> closed;
    /// Instead of `opened`. If empty, the server does not offer kFoxgloveProtocols.
    std::function<void(ClientId)> foxglove_opened = {};
};

class WebServer {
public:
    WebServer(const WebServerOptions& options, WebSocketEvents events);
    /// Closes all connections immediately. drain() sends queued messages first.
    ~WebServer();

    int port() const;
    /// For a browser on this machine. Contains the access token.
    std::string page_url() const;

    void send_text(ClientId client_id, std::string text);
    /// Replaces an older binary message that is still queued, because only the newest
    /// scan matters.
    void send_newest(ClientId client_id, std::string scan_message);
    /// Skips all messages if earlier messages are still queued, because the client is
    /// slow.
    void send_batch(ClientId client_id, std::vector<std::string> messages);
    /// Rejects new connections. Closes each WebSocket after its queued messages are sent,
    /// and waits until all are closed, but at most `max_wait`.
    void drain(std::chrono::milliseconds max_wait);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// @throws UsageError if the text is no IP address
void check_address(const std::string& address);

/// Returns 128 random bits as text.
std::string make_token();

}  // namespace relidar::view
