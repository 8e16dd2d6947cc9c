// SPDX-License-Identifier: Apache-2.0
// Errors of requests, as gRPC statuses.
#pragma once

#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include <grpcpp/support/status.h>

namespace relidar::serve {

/// A request that cannot be answered.
class Refusal : public std::runtime_error {
public:
    Refusal(grpc::StatusCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    grpc::StatusCode code() const { return code_; }

private:
    grpc::StatusCode code_;
};

/// Rejects an invalid field of a request.
/// @throws Refusal always
[[noreturn]] void refuse(const std::string& field, const std::string& found, const std::string& expected);

/// Rejects an unknown name.
/// @param known names that the message can suggest
/// @throws Refusal always
[[noreturn]] void refuse_unknown(const std::string& field, const std::string& name,
                                 const std::vector<std::string>& known);

/// Returns a text of a client for use in messages: on one line, and shortened if it is
/// long.
std::string quoted(const std::string& word);

/// Runs the function that answers a request. Converts its exceptions to a status with a
/// one-line message.
grpc::Status answered(const std::function<void()>& answer);

}  // namespace relidar::serve
