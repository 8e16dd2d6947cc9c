// SPDX-License-Identifier: Apache-2.0
#include "access.hpp"

#include <algorithm>

#include <boost/asio/ip/address.hpp>
#include <boost/beast/core/string.hpp>

namespace relidar::view {
namespace {

bool is_same_text(std::string_view first, std::string_view second) {
    return boost::beast::iequals({first.data(), first.size()}, {second.data(), second.size()});
}

bool is_port(std::string_view text) {
    return !text.empty() && text.size() <= 5 && text.find_first_not_of("0123456789") == text.npos;
}

/// Returns the host name in a text of the form "host", "host:port" or "[address]:port".
/// Returns an empty text for any other form.
std::string_view host_name(std::string_view host_and_port) {
    // An IPv6 address contains colons and is therefore in brackets.
    const bool has_brackets = host_and_port.starts_with('[');
    const std::size_t bracket = host_and_port.find(']');
    if (has_brackets && bracket == std::string_view::npos) return {};
    const std::size_t host_end =
        has_brackets ? bracket + 1 : std::min(host_and_port.find(':'), host_and_port.size());
    const std::string_view port_part = host_and_port.substr(host_end);  // ":port" or empty
    if (!port_part.empty() && (port_part.front() != ':' || !is_port(port_part.substr(1)))) return {};
    return has_brackets ? host_and_port.substr(1, bracket - 1) : host_and_port.substr(0, host_end);
}

}  // namespace

bool is_this_machine(std::string_view host, std::string_view machine_name) {
    const std::string_view name = host_name(host);
    if (name.empty()) return false;
    if (is_same_text(name, "localhost") || (!machine_name.empty() && is_same_text(name, machine_name)))
        return true;
    boost::system::error_code failed;
    boost::asio::ip::make_address(std::string(name), failed);
    return !failed;
}

bool is_same_origin(std::string_view origin, std::string_view host) {
    constexpr std::string_view kUrlScheme = "http://";
    return origin.empty() ||
           (origin.starts_with(kUrlScheme) && is_same_text(origin.substr(kUrlScheme.size()), host));
}

bool is_foxglove_origin(std::string_view origin) {
    if (origin == "https://app.foxglove.dev" || origin == "https://lichtblick-suite.github.io" ||
        origin == "file://")
        return true;
    const std::size_t scheme = origin.find("://");
    if (scheme == std::string_view::npos) return false;
    const std::string_view name = host_name(origin.substr(scheme + 3));
    return is_same_text(name, "localhost") || name == "127.0.0.1" || name == "::1";
}

bool is_same_secret(std::string_view given, std::string_view expected) {
    unsigned different_bits = given.size() == expected.size() ? 0u : 1u;
    for (std::size_t i = 0; i < expected.size(); ++i) {
        const char given_char = i < given.size() ? given[i] : '\0';
        different_bits |= static_cast<unsigned char>(given_char) ^ static_cast<unsigned char>(expected[i]);
    }
    return different_bits == 0u;
}

std::string_view find_list_value(std::string_view list, std::string_view name, char separator) {
    while (!list.empty()) {
        const std::size_t end = std::min(list.find(separator), list.size());
        std::string_view entry = list.substr(0, end);
        list.remove_prefix(std::min(end + 1, list.size()));
        while (entry.starts_with(' ')) entry.remove_prefix(1);
        if (entry.size() > name.size() && entry.starts_with(name) && entry[name.size()] == '=')
            return entry.substr(name.size() + 1);
    }
    return {};
}

}  // namespace relidar::view
