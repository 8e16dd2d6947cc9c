// SPDX-License-Identifier: Apache-2.0
// Sends arbitrary bytes, valid or invalid, to a server and returns the response.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

namespace relidar::test {

class RawClient {
public:
    explicit RawClient(int port);
    ~RawClient();
    RawClient(const RawClient&) = delete;
    RawClient& operator=(const RawClient&) = delete;

    bool send(std::string_view bytes);
    /// Receives bytes until the server closes the connection, `n_bytes` were received, or
    /// no byte arrives within `patience`.
    std::string receive(std::size_t n_bytes = SIZE_MAX,
                        std::chrono::milliseconds patience = std::chrono::seconds(3));
    void abort();

private:
    int socket_ = -1;
};

std::string ask(int port, std::string_view request);
int status_of(std::string_view answer);

/// Encodes a WebSocket frame in the form in which a client sends it.
/// @param first FIN, reserved bits and opcode
/// @param length length in the header, which may differ from the length of the payload
std::string frame(std::uint8_t first, std::string_view payload, bool masked, std::uint64_t length);
std::string make_text_frame(std::string_view text);

}  // namespace relidar::test
