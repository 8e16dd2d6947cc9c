// SPDX-License-Identifier: Apache-2.0
// Formats the result of a benchmark as text and as JSON. Both contain the same numbers.
#pragma once

#include <string>

namespace relidar {
class Device;
}

namespace relidar::cli {

struct DevCase;
struct BenchResult;
struct BenchSettings;

std::string format_result(const DevCase& setup, const BenchResult& result, const Device& device);

std::string result_json(const DevCase& setup, const BenchSettings& settings, const BenchResult& result,
                        const Device& device, const std::string& args);

}  // namespace relidar::cli
