// SPDX-License-Identifier: Apache-2.0
// Access control: checks host names, origins and tokens. All functions depend only on the
// header fields of a request. Private to the server.
#pragma once

#include <string>
#include <string_view>

namespace relidar::view {

/// Header fields of a request that identify its sender.
struct Credentials {
    std::string_view host;    ///< Value of the header Host.
    std::string_view origin;  ///< Value of the header Origin. Empty: the header is missing.
    std::string_view cookie;  ///< Value of the header Cookie.
    std::string_view query;   ///< Part of the request target after '?'.
};

/// Returns true if a Host header names this machine in a way that a foreign DNS server
/// cannot control: an IP address, "localhost", or `own_name`. Any port is accepted,
/// because a forwarded port differs.
bool is_own_host(std::string_view host, std::string_view own_name);
/// Returns true if the Origin header names the server itself or is missing. Only browsers
/// send an Origin, and they always send it with a WebSocket.
/// @param host Host header of the request
bool is_own_origin(std::string_view origin, std::string_view host);
/// Compares two secrets in constant time, so that the duration does not show how many
/// characters match.
bool same_secret(std::string_view a, std::string_view b);
/// Returns the value of a name in "a=1&b=2" (separator '&') or "a=1; b=2" (separator
/// ';'). Returns an empty text if the name is missing.
std::string_view value_of(std::string_view list, std::string_view name, char separator);
/// Returns true if the request contains the token, in the query as "token" or as the
/// cookie `cookie_name`.
bool shows_token(const Credentials& request, std::string_view token, std::string_view cookie_name);

}  // namespace relidar::view
