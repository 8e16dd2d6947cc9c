// SPDX-License-Identifier: Apache-2.0
// For addresses that other machines can reach, a server warns or requires a token.
#pragma once

#include <string>

#include <arpa/inet.h>

namespace relidar {

/// False for names other than "localhost", because they may resolve to another machine.
/// @param host IPv4 or IPv6 address, with or without brackets, or a name
inline bool is_loopback(std::string host) {
    if (host == "localhost") return true;
    if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
    in_addr v4{};
    // All addresses of 127.0.0.0/8 are loopback addresses (RFC 1122).
    if (::inet_pton(AF_INET, host.c_str(), &v4) == 1) return (ntohl(v4.s_addr) >> 24) == 127;
    in6_addr v6{};
    return ::inet_pton(AF_INET6, host.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

}  // namespace relidar
