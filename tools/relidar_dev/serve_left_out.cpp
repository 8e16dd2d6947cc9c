// SPDX-License-Identifier: Apache-2.0
// Replaces serve.cpp if the program is built without gRPC.
#include "serve.hpp"

#include <relidar/base/error.hpp>

namespace relidar::cli {

void run_service_benchmark(const ServeBenchOptions&) {
    throw UsageError(
        "--serve: this program was built without gRPC, expected one with it: `tools/dev/setup --serve`, then "
        "build again");
}

}  // namespace relidar::cli
