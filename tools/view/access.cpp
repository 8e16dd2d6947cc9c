// SPDX-License-Identifier: Apache-2.0
#include "access.hpp"

#include <algorithm>
#include <cctype>

#include <boost/asio/ip/address.hpp>

namespace relidar::view {
namespace {

bool are_equal_ignoring_case(std::string_view first, std::string_view second) {
    return std::equal(first.begin(), first.end(), second.begin(), second.end(), [](char x, char y) {
        return std::tolower(static_cast<unsigned char>(x)) == std::tolower(static_cast<unsigned char>(y));
    });
}

bool is_port(std::string_view text) {
    return !text.empty() && text.size() <= 5 && std::all_of(text.begin(), text.end(), [](char character) {
        return character >= '0' && character <= '9';
    });
}

/// Returns the host name in a text of the form "host", "host:port" or "[address]:port".
/// Returns an empty text for any other form.
std::string_view remove_port(std::string_view host) {
    std::size_t end = host.find(':');
    if (host.starts_with('[')) {
        const std::size_t bracket = host.find(']');
        if (bracket == std::string_view::npos) return {};
        end = bracket + 1;
        if (end == host.size()) return host.substr(1, bracket - 1);
        if (host[end] != ':' || !is_port(host.substr(end + 1))) return {};
        return host.substr(1, bracket - 1);
    }
    if (end == std::string_view::npos) return host;
    return is_port(host.substr(end + 1)) ? host.substr(0, end) : std::string_view{};
}

}  // namespace

bool is_local_host(std::string_view host, std::string_view host_name) {
    const std::string_view name = remove_port(host);
    if (name.empty()) return false;
    if (are_equal_ignoring_case(name, "localhost") ||
        (!host_name.empty() && are_equal_ignoring_case(name, host_name)))
        return true;
    boost::system::error_code failed;
    boost::asio::ip::make_address(std::string(name), failed);
    return !failed;
}

bool is_same_origin(std::string_view origin, std::string_view host) {
    constexpr std::string_view kScheme = "http://";
    return origin.empty() ||
           (origin.starts_with(kScheme) && are_equal_ignoring_case(origin.substr(kScheme.size()), host));
}

bool is_foxglove_origin(std::string_view origin) {
    if (origin == "https://app.foxglove.dev" || origin == "https://lichtblick-suite.github.io" ||
        origin == "file://")
        return true;
    const std::size_t scheme = origin.find("://");
    if (scheme == std::string_view::npos) return false;
    const std::string_view name = remove_port(origin.substr(scheme + 3));
    return are_equal_ignoring_case(name, "localhost") || name == "127.0.0.1" || name == "::1";
}

bool is_same_secret(std::string_view first, std::string_view second) {
    unsigned differs = first.size() == second.size() ? 0u : 1u;
    // Always compares all characters of the secret `second`, so that the duration does
    // not show how many characters of `first` are right.
    for (std::size_t i = 0; i < second.size(); ++i) {
        const char shown = i < first.size() ? first[i] : '\0';
        differs |= static_cast<unsigned char>(shown) ^ static_cast<unsigned char>(second[i]);
    }
    return differs == 0u;
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

bool has_token_in_url(const Credentials& request, std::string_view token) {
    return is_same_secret(find_list_value(request.query, "token", '&'), token);
}

bool has_token_in_cookie(const Credentials& request, std::string_view token, std::string_view cookie_name) {
    return is_same_secret(find_list_value(request.cookie, cookie_name, ';'), token);
}

}  // namespace relidar::view
