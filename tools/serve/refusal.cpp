// SPDX-License-Identifier: Apache-2.0
#include "refusal.hpp"

#include <algorithm>
#include <new>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar::serve {

void throw_refusal(const std::string& field, const std::string& found_value, const std::string& expected) {
    throw Refusal(grpc::StatusCode::INVALID_ARGUMENT,
                  fmt::format("cannot read {}: found {}, expected {}", field, found_value, expected));
}

void throw_unknown_name(const std::string& field, const std::string& name,
                        const std::vector<std::string>& known_names) {
    const std::string nearest = find_nearest_name(name.substr(0, 80), known_names);
    const std::string expected = nearest.empty() ? "no name, because none exists"
                                                 : fmt::format("an existing name such as \"{}\"", nearest);
    throw Refusal(grpc::StatusCode::NOT_FOUND,
                  fmt::format("cannot read {}: found {}, expected {}", field, quoted(name), expected));
}

std::string quoted(const std::string& word) {
    constexpr std::size_t kMost = 80;
    std::size_t n = std::min(word.size(), kMost);
    // Cuts the text before a UTF-8 character, not in the middle of it.
    while (n < word.size() && n > 0 && (static_cast<unsigned char>(word[n]) & 0xc0) == 0x80) --n;
    std::string shown = word.substr(0, n);
    std::replace_if(
        shown.begin(), shown.end(),
        [](unsigned char character) { return character < 0x20 || character == 0x7f; }, ' ');
    return n == word.size() ? fmt::format("\"{}\"", shown)
                            : fmt::format("\"{}...\" of {} bytes", shown, word.size());
}

grpc::Status run_with_grpc_status(const std::function<void()>& answer) {
    try {
        answer();
        return grpc::Status::OK;
    } catch (const Refusal& refusal) {
        return {refusal.code(), refusal.what()};
    } catch (const UsageError& error) {
        return {grpc::StatusCode::INVALID_ARGUMENT, error.what()};
    } catch (const std::bad_alloc&) {
        return {grpc::StatusCode::RESOURCE_EXHAUSTED,
                "cannot answer the request: the server is out of memory; send a smaller request"};
    } catch (const DeviceLost& error) {
        return {grpc::StatusCode::UNAVAILABLE,
                fmt::format("{}; this server process ends and must be restarted", error.what())};
        // Other exceptions come from the device, from a changed run folder, or from a
        // bug.
    } catch (const std::exception& error) {
        return {grpc::StatusCode::INTERNAL, error.what()};
    }
}

}  // namespace relidar::serve
