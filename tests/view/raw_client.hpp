// SPDX-License-Identifier: Apache-2.0
// Sends arbitrary bytes, valid or invalid, to a server and returns the response.
#pragma once

#include <chrono>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

namespace relidar::test {

class RawClient {
public:
    explicit RawClient(int port) : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
        sockaddr_in address{};
        address.sin_family = AF_INET;
        address.sin_port = htons(static_cast<std::uint16_t>(port));
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        if (::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) return;
        abort();
        throw std::runtime_error("no connection to port " + std::to_string(port));
    }
    ~RawClient() {
        if (socket_ >= 0) ::close(socket_);
    }
    RawClient(const RawClient&) = delete;
    RawClient& operator=(const RawClient&) = delete;

    bool send(std::string_view bytes) {
        while (!bytes.empty()) {
            const ssize_t n = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
            if (n <= 0) return false;
            bytes.remove_prefix(static_cast<std::size_t>(n));
        }
        return true;
    }
    /// Receives bytes until the server closes the connection, `n_bytes` were received, or
    /// no byte arrives within `patience`.
    std::string receive(std::size_t n_bytes = SIZE_MAX,
                        std::chrono::milliseconds patience = std::chrono::seconds(3)) {
        std::string all;
        char part[65536];
        while (all.size() < n_bytes) {
            pollfd poll_request{socket_, POLLIN, 0};
            if (::poll(&poll_request, 1, static_cast<int>(patience.count())) <= 0) break;
            const ssize_t n = ::recv(socket_, part, std::min(sizeof part, n_bytes - all.size()), 0);
            if (n <= 0) break;
            all.append(part, static_cast<std::size_t>(n));
        }
        return all;
    }
    /// Resets the connection.
    void abort() {
        const linger at_once{1, 0};
        ::setsockopt(socket_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
        ::close(std::exchange(socket_, -1));
    }

private:
    int socket_ = -1;
};

inline std::string ask(int port, std::string_view request) {
    RawClient client(port);
    client.send(request);
    return client.receive();
}

inline int status_of(std::string_view answer) {
    return answer.starts_with("HTTP/1.1 ") && answer.size() >= 12
               ? std::stoi(std::string(answer.substr(9, 3)))
               : 0;
}

/// @param fields further fields of the header, each with its line end
inline std::string make_upgrade_request(const std::string& fields = "Host: localhost\r\n",
                                        const std::string& target = "/live") {
    return "GET " + target + " HTTP/1.1\r\n" + fields +
           "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: "
           "dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n";
}

/// Encodes a WebSocket frame in the form in which a client sends it.
/// @param first FIN, reserved bits and opcode
/// @param length length in the header, which may differ from the length of the payload
inline std::string frame(std::uint8_t first, std::string_view payload, bool masked, std::uint64_t length) {
    std::string bytes(1, static_cast<char>(first));
    const auto mask_bit = static_cast<char>(masked ? 0x80 : 0);
    // Short lengths fit into the second byte. Longer ones follow in 2 or 8 extra bytes.
    const int n_extra = length >= 65536 ? 8 : length >= 126 ? 2 : 0;
    const std::uint64_t short_length = n_extra == 8 ? 127 : n_extra == 2 ? 126 : length;
    bytes += static_cast<char>(mask_bit | static_cast<char>(short_length));
    for (int i = n_extra - 1; i >= 0; --i) bytes += static_cast<char>((length >> (8 * i)) & 0xff);
    constexpr char kMask[4] = {0x12, 0x34, 0x56, 0x78};
    if (masked) bytes.append(kMask, 4);
    for (std::size_t i = 0; i < payload.size(); ++i)
        bytes += static_cast<char>(masked ? payload[i] ^ kMask[i % 4] : payload[i]);
    return bytes;
}

}  // namespace relidar::test
