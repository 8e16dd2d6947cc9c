// SPDX-License-Identifier: Apache-2.0
#include "access.hpp"

#include <algorithm>
#include <cctype>

#include <boost/asio/ip/address.hpp>

namespace relidar::view {
namespace {

bool is_same_text(std::string_view first, std::string_view second) {
    return std::equal(first.begin(), first.end(), second.begin(), second.end(), [](char x, char y) {
        return std::tolower(static_cast<unsigned char>(x)) == std::tolower(static_cast<unsigned char>(y));
    });
}

bool is_port(std::string_view text) {
    return !text.empty() && text.size() <= 5 && std::all_of(text.begin(), text.end(), [](char character) {
        return character >= '0' && character <= '9';
    });
}

/// From "host", "host:port" or "[address]:port". Otherwise empty.
std::string_view host_name(std::string_view host_and_port) {
    std::size_t end = host_and_port.find(':');
    if (host_and_port.starts_with('[')) {
        const std::size_t bracket = host_and_port.find(']');
        if (bracket == std::string_view::npos) return {};
        end = bracket + 1;
        if (end == host_and_port.size()) return host_and_port.substr(1, bracket - 1);
        if (host_and_port[end] != ':' || !is_port(host_and_port.substr(end + 1))) return {};
        return host_and_port.substr(1, bracket - 1);
    }
    if (end == std::string_view::npos) return host_and_port;
    return is_port(host_and_port.substr(end + 1)) ? host_and_port.substr(0, end) : std::string_view{};
}

}  // namespace

bool is_this_machine(std::string_view host_header, std::string_view machine_name) {
    const std::string_view name = host_name(host_header);
    if (name.empty()) return false;
    if (is_same_text(name, "localhost") || (!machine_name.empty() && is_same_text(name, machine_name)))
        return true;
    boost::system::error_code failed;
    boost::asio::ip::make_address(std::string(name), failed);
    return !failed;
}

bool is_same_origin(std::string_view origin_header, std::string_view host_header) {
    constexpr std::string_view kUrlScheme = "http://";
    return origin_header.empty() || (origin_header.starts_with(kUrlScheme) &&
                                     is_same_text(origin_header.substr(kUrlScheme.size()), host_header));
}

bool is_foxglove_origin(std::string_view origin_header) {
    if (origin_header == "https://app.foxglove.dev" ||
        origin_header == "https://lichtblick-suite.github.io" || origin_header == "file://")
        return true;
    const std::size_t scheme = origin_header.find("://");
    if (scheme == std::string_view::npos) return false;
    const std::string_view name = host_name(origin_header.substr(scheme + 3));
    return is_same_text(name, "localhost") || name == "127.0.0.1" || name == "::1";
}

bool is_same_secret(std::string_view given_secret, std::string_view true_secret) {
    unsigned differs = given_secret.size() == true_secret.size() ? 0u : 1u;
    for (std::size_t i = 0; i < true_secret.size(); ++i) {
        const char shown = i < given_secret.size() ? given_secret[i] : '\0';
        differs |= static_cast<unsigned char>(shown) ^ static_cast<unsigned char>(true_secret[i]);
    }
    return differs == 0u;
}

std::string_view find_list_value(std::string_view name_value_list, std::string_view name, char separator) {
    while (!name_value_list.empty()) {
        const std::size_t end = std::min(name_value_list.find(separator), name_value_list.size());
        std::string_view entry = name_value_list.substr(0, end);
        name_value_list.remove_prefix(std::min(end + 1, name_value_list.size()));
        while (entry.starts_with(' ')) entry.remove_prefix(1);
        if (entry.size() > name.size() && entry.starts_with(name) && entry[name.size()] == '=')
            return entry.substr(name.size() + 1);
    }
    return {};
}

bool has_query_token(const Credentials& credentials, std::string_view access_token) {
    return is_same_secret(find_list_value(credentials.query, "token", '&'), access_token);
}

bool has_cookie_token(const Credentials& credentials, std::string_view access_token,
                      std::string_view cookie_name) {
    return is_same_secret(find_list_value(credentials.cookie, cookie_name, ';'), access_token);
}

}  // namespace relidar::view
