// SPDX-License-Identifier: Apache-2.0
// Replaces serve.cpp if the program is built without gRPC.
#include "serve.hpp"

#include <relidar/base/error.hpp>

namespace relidar::cli {

void bench_service(const ServeBenchOptions&) {
    throw UsageError(
        "--serve is not available, because relidar-dev was built without gRPC; run `tools/dev/setup --serve` "
        "and build it again");
}

}  // namespace relidar::cli
