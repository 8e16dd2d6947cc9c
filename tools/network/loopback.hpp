// SPDX-License-Identifier: Apache-2.0
// Detects addresses that are reachable from this machine only. For other addresses the
// servers print a warning or require a token.
#pragma once

#include <string>

#include <arpa/inet.h>

namespace relidar {

/// Returns true for a loopback address.
/// @param host a literal IPv4 or IPv6 address, with or without brackets, or "localhost".
/// Returns false for other names, because they may resolve to another machine.
inline bool is_loopback(std::string host) {
    if (host == "localhost") return true;
    if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
    in_addr v4{};
    // All addresses of 127.0.0.0/8 (RFC 1122).
    if (::inet_pton(AF_INET, host.c_str(), &v4) == 1) return (ntohl(v4.s_addr) >> 24) == 127;
    in6_addr v6{};
    return ::inet_pton(AF_INET6, host.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

}  // namespace relidar
