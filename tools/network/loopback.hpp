// SPDX-License-Identifier: Apache-2.0
// Which addresses are reached from this machine alone: the servers warn of others, or ask
// for a token.
#pragma once

#include <string>

#include <arpa/inet.h>

namespace relidar {

/// @param host  a literal IPv4 or IPv6 address, the latter in brackets or not, or
/// "localhost"; any other name may be somebody else's: false
inline bool is_loopback(std::string host) {
    if (host == "localhost") return true;
    if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
    in_addr v4{};
    // RFC 1122: all of 127.0.0.0/8
    if (::inet_pton(AF_INET, host.c_str(), &v4) == 1) return (ntohl(v4.s_addr) >> 24) == 127;
    in6_addr v6{};
    return ::inet_pton(AF_INET6, host.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

}  // namespace relidar
