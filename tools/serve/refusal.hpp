// SPDX-License-Identifier: Apache-2.0
// Why a request is not answered, as a gRPC status.
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

/// Of a field of a request that makes no sense. @throws Refusal, always
[[noreturn]] void refuse(const std::string& field, const std::string& found, const std::string& expected);

/// Of a name that nothing has. @param known  where there is anything to be meant instead
/// @throws Refusal, always
[[noreturn]] void refuse_unknown(const std::string& field, const std::string& name,
                                 const std::vector<std::string>& known);

/// A client's word as messages show it: cut where it is long, in one line.
std::string quoted(const std::string& word);

/// Runs what answers a request, and turns whatever it throws into a status of one line.
grpc::Status answered(const std::function<void()>& answer);

}  // namespace relidar::serve
