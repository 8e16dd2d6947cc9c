// SPDX-License-Identifier: Apache-2.0
// A client that sends any bytes it likes, right or wrong, and says what came back.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

namespace relidar::test {

class RawClient {
public:
    /// Connects to a port of 127.0.0.1. @throws std::runtime_error where nobody listens
    explicit RawClient(int port);
    ~RawClient();
    RawClient(const RawClient&) = delete;
    RawClient& operator=(const RawClient&) = delete;

    /// @return false where the other side has closed
    bool send(std::string_view bytes);
    /// What comes until the other side closes, `n_bytes` are there, or nothing has come
    /// for a while.
    std::string receive(std::size_t n_bytes = SIZE_MAX,
                        std::chrono::milliseconds patience = std::chrono::seconds(3));
    /// Closes without waiting for anything: no port stays occupied.
    void abort();

private:
    int socket_ = -1;
};

/// Answer to one request, connection closed afterwards.
std::string ask(int port, std::string_view request);
/// The number in "HTTP/1.1 404 Not Found"; 0 where there is none.
int status_of(std::string_view answer);

/// A WebSocket frame as a client sends it. @param first  FIN, reserved bits and opcode
/// @param length  told, whatever the payload's is
std::string frame(std::uint8_t first, std::string_view payload, bool masked, std::uint64_t length);
std::string text_frame(std::string_view text);

}  // namespace relidar::test
