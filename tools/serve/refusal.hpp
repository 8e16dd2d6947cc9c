// SPDX-License-Identifier: Apache-2.0
// Errors that a client receives as gRPC statuses.
#pragma once

#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <grpcpp/support/status.h>

namespace relidar::serve {

/// The client receives the gRPC code and the message.
class RejectedRequest : public std::runtime_error {
public:
    RejectedRequest(grpc::StatusCode code, const std::string& message)
        : std::runtime_error(message), code_(code) {}
    grpc::StatusCode code() const { return code_; }

private:
    grpc::StatusCode code_;
};

/// @throws RejectedRequest always, with the formatted text
template <class... T>
[[noreturn]] void refuse(grpc::StatusCode code, fmt::format_string<T...> text, T&&... values) {
    throw RejectedRequest(code, fmt::format(text, std::forward<T>(values)...));
}

/// @throws RejectedRequest always
[[noreturn]] void reject_field(const std::string& field_name, const std::string& found_value_text,
                               const std::string& expected_value_text);

/// Suggests a similar valid name.
/// @throws RejectedRequest always
[[noreturn]] void reject_name(const std::string& field_name, const std::string& name,
                              const std::vector<std::string>& valid_names);

/// Removes line breaks and shortens long texts.
std::string quote_client_text(const std::string& client_text);

/// Converts an exception into an error status with a one-line message.
grpc::Status call_handler(const std::function<void()>& handle_request);

}  // namespace relidar::serve
