// SPDX-License-Identifier: Apache-2.0
// What the benchmarks on runs of a synthetic street share.
#pragma once

#include <functional>
#include <string>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

/// Returns the options of the synthetic street on which a run was trained.
/// @throws DataError if the log of the run is not a street.toml
inline StreetOptions read_street(const Run& run) {
    const std::string dataset = run.config.dataset.path, prefix = "synthetic:";
    return load_street(dataset.starts_with(prefix) ? dataset.substr(prefix.size()) : dataset);
}

/// Calls `run` with the only argument of the program. Prints errors as one line.
/// @return exit code of the program
inline int run_on_argument(int argc, char** argv, const std::function<void(const std::string&)>& run) {
    try {
        if (argc != 2) throw UsageError("expected the folder of a run of a synthetic street");
        run(argv[1]);
        return 0;
    } catch (const Error& error) {
        fmt::print(stderr, "{}: {}\n", argv[0], error.what());
        return int(error.code());
    }
}

}  // namespace relidar
