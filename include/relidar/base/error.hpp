// SPDX-License-Identifier: Apache-2.0
// Exceptions of relidar. Messages are one line: what failed, found and expected.
#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Exit codes of the command line tool.
enum class ExitCode : int { ok = 0, bug = 1, usage = 2, data = 3, device = 4, interrupted = 130 };

/// Base class of all exceptions that relidar throws.
class Error : public std::runtime_error {
public:
    Error(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ExitCode code() const { return code_; }

private:
    ExitCode code_;
};

/// Error for a wrong flag, a wrong key or a wrong combination of options (exit code 2).
struct UsageError : Error {
    explicit UsageError(const std::string& message) : Error(ExitCode::usage, message) {}
};

/// Error for input that is missing, malformed or impossible, and for output that cannot
/// be written (exit code 3).
struct DataError : Error {
    explicit DataError(const std::string& message) : Error(ExitCode::data, message) {}
};

/// Error for a missing device, a missing feature, a failed Vulkan call or exhausted
/// device memory (exit code 4).
struct DeviceError : Error {
    explicit DeviceError(const std::string& message) : Error(ExitCode::device, message) {}
};

/// Error for a device that hung, was removed, or restarted its driver. The process cannot
/// use this device again.
struct DeviceLost : DeviceError {
    using DeviceError::DeviceError;
};

/// Returns the valid name that is most similar to the query, for "did you mean" messages.
/// The most similar name has the smallest edit distance. Upper and lower case are treated
/// as equal.
/// @return empty string if `names` is empty
std::string nearest_name(std::string_view query, const std::vector<std::string>& names);
/// Returns the text ", did you mean 'NAME'?", where NAME is the most similar valid name.
/// @param quote quotation mark around the name: "'", "\"" or empty
/// @return `otherwise` if no valid name is similar
std::string did_you_mean(std::string_view query, const std::vector<std::string>& names,
                         std::string_view quote = "", std::string_view otherwise = "");
/// Returns the valid name that equals the query, ignoring upper and lower case. Returns
/// nullopt if no valid name is equal.
std::optional<std::string> find_name(std::string_view query, const std::vector<std::string>& names);

}  // namespace relidar
