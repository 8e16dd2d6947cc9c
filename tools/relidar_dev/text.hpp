// SPDX-License-Identifier: Apache-2.0
// Formats a benchmark result as text and as JSON, with the same numbers.
#pragma once

#include <string>

namespace relidar {
class Device;
}

namespace relidar::cli {

struct DevCase;
struct BenchResult;
struct BenchSettings;

std::string bench_text(const DevCase& bench, const BenchResult& result, const Device& device);

/// Returns the result as JSON.
/// @param command_line command line as typed
std::string bench_json(const DevCase& bench, const BenchSettings& settings, const BenchResult& result,
                       const Device& device, const std::string& command_line);

}  // namespace relidar::cli
