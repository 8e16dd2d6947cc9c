// SPDX-License-Identifier: Apache-2.0
// `relidar-dev bench --serve`: how long clients of a running service wait.
#pragma once

#include <string>

namespace relidar::cli {

struct ServeBench {
    std::string address;  ///< empty: not asked for
    std::string scene, sensor;
    int clients = 1;
    int calls = 100;
};

/// Prints latencies and scans a second.
/// @throws UsageError where this program was built without the service, DataError where
/// nothing answers
void bench_service(const ServeBench& bench);

}  // namespace relidar::cli
