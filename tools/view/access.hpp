// SPDX-License-Identifier: Apache-2.0
// Access control: depends only on the header fields and the URL of an HTTP request.
#pragma once

#include <string_view>

namespace relidar::view {

/// Returns true for an IP address, "localhost", or `machine_name`. Other names are
/// rejected, because an attacker's DNS server could resolve them to this machine (DNS
/// rebinding). The port is not checked, because a forwarded port has another number.
bool is_this_machine(std::string_view host, std::string_view machine_name);
/// Returns true if the page that sends a request comes from this server, or if no origin
/// is given. Only browsers send the header Origin when they open a WebSocket.
/// @param host value of the Host header in the same request
bool is_same_origin(std::string_view origin, std::string_view host);
/// Returns true for the web pages of Foxglove and Lichtblick, a page of this machine, or
/// a desktop program, whose page is a file.
bool is_foxglove_origin(std::string_view origin);
/// Compares two secrets in constant time, so that the duration does not show how many
/// characters match.
bool is_same_secret(std::string_view given, std::string_view expected);
/// Returns the value of a name, or an empty text, in a list such as "a=1&b=2" (separator
/// '&') or "a=1; b=2" (separator ';').
std::string_view find_list_value(std::string_view list, std::string_view name, char separator);

}  // namespace relidar::view
