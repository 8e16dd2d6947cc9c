// SPDX-License-Identifier: Apache-2.0
#include "raw_client.hpp"

#include <stdexcept>

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

namespace relidar::test {

RawClient::RawClient(int port) : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (socket_ < 0 || ::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
        abort();
        throw std::runtime_error("no connection to port " + std::to_string(port));
    }
}

RawClient::~RawClient() {
    if (socket_ >= 0) ::close(socket_);
}

bool RawClient::send(std::string_view bytes) {
    while (!bytes.empty()) {
        const ssize_t n = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
        if (n <= 0) return false;
        bytes.remove_prefix(static_cast<std::size_t>(n));
    }
    return true;
}

std::string RawClient::receive(std::size_t n_bytes, std::chrono::milliseconds patience) {
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

void RawClient::abort() {
    if (socket_ < 0) return;
    const linger at_once{1, 0};
    ::setsockopt(socket_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    ::close(socket_);
    socket_ = -1;
}

std::string ask(int port, std::string_view request) {
    RawClient client(port);
    client.send(request);
    return client.receive();
}

int status_of(std::string_view answer) {
    return answer.starts_with("HTTP/1.1 ") && answer.size() >= 12
               ? std::stoi(std::string(answer.substr(9, 3)))
               : 0;
}

std::string frame(std::uint8_t first, std::string_view payload, bool masked, std::uint64_t length) {
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

std::string make_text_frame(std::string_view text) { return frame(0x81, text, true, text.size()); }

}  // namespace relidar::test
