// SPDX-License-Identifier: Apache-2.0
#include "refusal.hpp"

#include <algorithm>
#include <new>

#include <relidar/base/error.hpp>

namespace relidar::serve {

/// Rejects a request because of the value of a field.
void reject_field(const std::string& field, const std::string& found, const std::string& expected) {
    refuse(Code::INVALID_ARGUMENT, "cannot read {}: found {}, expected {}", field, found, expected);
}

/// Rejects a request because a name is unknown, and suggests a similar name.
void reject_name(const std::string& field, const std::string& name, const std::vector<std::string>& names) {
    const std::string nearest = nearest_name(name.substr(0, 80), names);
    const std::string expected = nearest.empty() ? "an empty field, because no names are available"
                                                 : fmt::format("an existing name such as \"{}\"", nearest);
    refuse(Code::NOT_FOUND, "cannot read {}: found {}, expected {}", field, quote_client_text(name),
           expected);
}

/// Puts a client's text into quotes for an error message. Replaces control characters by
/// spaces, because a message has one line, and shortens long texts.
std::string quote_client_text(const std::string& text) {
    constexpr std::size_t kMaxQuotedBytes = 80;
    std::size_t n = std::min(text.size(), kMaxQuotedBytes);
    // Cuts the text before a UTF-8 character, not in the middle of it: its bytes after
    // the first have the bits 10xxxxxx.
    const auto continues_character = [](char byte) {
        return (static_cast<unsigned char>(byte) & 0xc0) == 0x80;
    };
    while (n < text.size() && n > 0 && continues_character(text[n])) --n;
    std::string shown = text.substr(0, n);
    std::replace_if(
        shown.begin(), shown.end(),
        [](unsigned char character) { return character < 0x20 || character == 0x7f; }, ' ');
    return n == text.size() ? fmt::format("\"{}\"", shown)
                            : fmt::format("\"{}...\" of {} bytes", shown, text.size());
}

/// Calls the function that handles a request. Converts its exceptions to an error status,
/// so that no exception reaches gRPC.
grpc::Status call_handler(const std::function<void()>& handle_request) {
    try {
        handle_request();
        return grpc::Status::OK;
    } catch (const RejectedRequest& refusal) {
        return {refusal.code(), refusal.what()};
    } catch (const UsageError& error) {
        return {Code::INVALID_ARGUMENT, error.what()};
    } catch (const std::bad_alloc&) {
        return {Code::RESOURCE_EXHAUSTED,
                "cannot answer the request: the server is out of memory; send a smaller request"};
    } catch (const DeviceLost& error) {
        return {Code::UNAVAILABLE,
                fmt::format("{}; this server process is ending; restart the server", error.what())};
    } catch (const std::exception& error) {
        // A device error, a run folder that was modified on disk, or a bug.
        return {Code::INTERNAL, error.what()};
    }
}

}  // namespace relidar::serve
