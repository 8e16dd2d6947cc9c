// SPDX-License-Identifier: Apache-2.0
// Access control: checks host names, origins and tokens. The result depends only on the
// header fields of the HTTP request. Only the server includes this header.
#pragma once

#include <string>
#include <string_view>

namespace relidar::view {

/// Header fields of an HTTP request that identify its sender.
struct Credentials {
    std::string_view host;    ///< Value of the header Host.
    std::string_view origin;  ///< Value of the Origin header. It is empty if the header is missing.
    std::string_view cookie;  ///< Value of the header Cookie.
    std::string_view query;   ///< Part of the URL after '?'.
};

/// Returns true if a Host header names this machine: an IP address, "localhost", or
/// `host_name`. Other names are rejected, because a foreign DNS server could resolve them
/// to this machine. Any port is accepted, because a forwarded port has another number.
bool is_local_host(std::string_view host, std::string_view host_name);
/// Returns true if the Origin header names this server or is missing. A browser always
/// sends this header when it opens a WebSocket. Other programs do not send it.
/// @param host value of the Host header of the same request
bool is_same_origin(std::string_view origin, std::string_view host);
/// Compares two secrets in constant time. Otherwise the duration would show how many
/// characters match.
bool same_secret(std::string_view a, std::string_view b);
/// Returns the value of a name in a list such as "a=1&b=2" (separator '&') or "a=1; b=2"
/// (separator ';'). Returns an empty text if the list does not contain the name.
std::string_view value_of(std::string_view list, std::string_view name, char separator);
/// Returns true if the request contains the access token. The token may be the value of
/// "token" in the URL, or of the cookie `cookie_name`.
bool shows_token(const Credentials& request, std::string_view token, std::string_view cookie_name);

}  // namespace relidar::view
