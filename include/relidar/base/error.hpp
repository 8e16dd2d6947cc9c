// SPDX-License-Identifier: Apache-2.0
// Failures a caller can meet. Every message is one line: what was being done: what was
// found, what was expected.
#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Exit codes of the command line tool.
enum class ExitCode : int { ok = 0, bug = 1, usage = 2, data = 3, device = 4, interrupted = 130 };

/// Base of all failures relidar reports.
class Error : public std::runtime_error {
public:
    Error(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ExitCode code() const { return code_; }

private:
    ExitCode code_;
};

/// A wrong flag, key or combination of options (exit code 2).
struct UsageError : Error {
    explicit UsageError(const std::string& message) : Error(ExitCode::usage, message) {}
};

/// A file or value in the input is missing, malformed or impossible; output that cannot
/// be written (exit code 3).
struct DataError : Error {
    explicit DataError(const std::string& message) : Error(ExitCode::data, message) {}
};

/// No device, a missing feature, a failed Vulkan call or exhausted device memory (exit
/// code 4).
struct DeviceError : Error {
    explicit DeviceError(const std::string& message) : Error(ExitCode::device, message) {}
};

/// The device hung, was taken away, or its driver was restarted. It does not work again
/// in this process.
struct DeviceLost : DeviceError {
    using DeviceError::DeviceError;
};

/// The known name a mistyped one was most likely meant to be (smallest edit distance,
/// case ignored), for "did you mean".
/// @return empty where `known` is empty
std::string nearest_name(std::string_view wanted, const std::vector<std::string>& known);
/// ", did you mean 'NAME'?" with the nearest known name. @return `otherwise` where none
/// resembles what was wanted
/// @param quote  around the name: "'", "\"" or nothing
std::string did_you_mean(std::string_view wanted, const std::vector<std::string>& known,
                         std::string_view quote = "", std::string_view otherwise = "");
/// The known name that a user means who writes it in another case; nothing where there is
/// none.
std::optional<std::string> known_name(std::string_view wanted, const std::vector<std::string>& known);

}  // namespace relidar
