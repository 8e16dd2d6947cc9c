// SPDX-License-Identifier: Apache-2.0
// Errors that a client receives as gRPC statuses.
#pragma once

#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include <grpcpp/support/status.h>

namespace relidar::serve {

/// Exception for a request that cannot be answered.
class Refusal : public std::runtime_error {
public:
    Refusal(grpc::StatusCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    grpc::StatusCode code() const { return code_; }

private:
    grpc::StatusCode code_;
};

/// Rejects a request because one field has an invalid value.
/// @throws Refusal always
[[noreturn]] void refuse(const std::string& field, const std::string& found, const std::string& expected);

/// Rejects a request because it contains an unknown name.
/// @param known valid names, of which the error message may suggest one
/// @throws Refusal always
[[noreturn]] void refuse_unknown(const std::string& field, const std::string& name,
                                 const std::vector<std::string>& known);

/// Quotes a text of a client for use in an error message. Removes line breaks and
/// shortens long texts.
std::string quoted(const std::string& word);

/// Runs the function that answers a request, and returns a gRPC status. An exception
/// becomes an error status with a one-line message.
grpc::Status answered(const std::function<void()>& answer);

}  // namespace relidar::serve
