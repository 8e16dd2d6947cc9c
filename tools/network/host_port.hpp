// SPDX-License-Identifier: Apache-2.0
// Addresses that users type: 127.0.0.1:50051, [::1]:50051 or localhost:50051.
#pragma once

#include <charconv>
#include <string>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {

inline constexpr int kLastPort = 65535;

struct HostPort {
    std::string host;  ///< Host name or address. An IPv6 address has no brackets.
    int port = 0;
};

/// @param min_port 0 if port 0 may select a free port, otherwise 1
/// @throws UsageError if the text is not HOST:PORT with a valid port
inline HostPort parse_host_port(const std::string& text, const std::string& option_name, int min_port) {
    const auto fail = [&] {
        throw UsageError(fmt::format("{}: found '{}', expected HOST:PORT with a port from {} to {}",
                                     option_name, text, min_port, kLastPort));
    };
    const std::size_t colon = text.rfind(':');
    if (colon == std::string::npos || colon == 0) fail();
    HostPort address{text.substr(0, colon), -1};
    const char *begin = text.data() + colon + 1, *end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(begin, end, address.port);
    if (error != std::errc() || stop != end || address.port < min_port || address.port > kLastPort) fail();
    std::string& host = address.host;
    const bool is_bracketed = host.size() > 2 && host.front() == '[' && host.back() == ']';
    if (is_bracketed) host = host.substr(1, host.size() - 2);
    if (host.find_first_of("[]") != std::string::npos ||
        (!is_bracketed && host.find(':') != std::string::npos))
        fail();
    return address;
}

}  // namespace relidar
