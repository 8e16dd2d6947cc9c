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

using Code = grpc::StatusCode;

class RejectedRequest : public std::runtime_error {
public:
    RejectedRequest(Code code, const std::string& message) : std::runtime_error(message), code_(code) {}
    Code code() const { return code_; }

private:
    Code code_;
};

template <class... T>
[[noreturn]] void refuse(Code code, fmt::format_string<T...> text, T&&... values) {
    throw RejectedRequest(code, fmt::format(text, std::forward<T>(values)...));
}

[[noreturn]] void reject_field(const std::string& field, const std::string& found,
                               const std::string& expected);

[[noreturn]] void reject_name(const std::string& field, const std::string& name,
                              const std::vector<std::string>& names);

std::string quote_client_text(const std::string& text);

grpc::Status call_handler(const std::function<void()>& handle);

}  // namespace relidar::serve
