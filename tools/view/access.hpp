// SPDX-License-Identifier: Apache-2.0
// Who may ask: host names, origins, tokens. Pure functions of a request's header fields.
// Private to the server.
#pragma once

#include <string>
#include <string_view>

namespace relidar::view {

/// What a request says of where it comes from.
struct Credentials {
    std::string_view host;    ///< header Host
    std::string_view origin;  ///< header Origin; empty: none
    std::string_view cookie;  ///< header Cookie
    std::string_view query;   ///< of the target, after '?'
};

/// Whether a Host names this machine in a way that no foreign DNS can: an address,
/// "localhost", or `own_name`; with any port, since a forwarded one is another.
bool is_own_host(std::string_view host, std::string_view own_name);
/// Whether an Origin is the server that is asked as `host`; none is: only browsers send
/// one, and always with a WebSocket.
bool is_own_origin(std::string_view origin, std::string_view host);
/// Compares in a time that does not tell how much was right.
bool same_secret(std::string_view a, std::string_view b);
/// Value of a name in "a=1&b=2" (separator '&') or "a=1; b=2" (separator ';'), empty
/// where there is none.
std::string_view value_of(std::string_view list, std::string_view name, char separator);
/// Whether the token is shown, in the query as "token" or as the cookie of that name.
bool shows_token(const Credentials& request, std::string_view token, std::string_view cookie_name);

}  // namespace relidar::view
