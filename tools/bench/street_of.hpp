// SPDX-License-Identifier: Apache-2.0
// Reads which synthetic street a run was trained on.
#pragma once

#include <string>

#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

/// Returns the options of the synthetic street on which a run was trained.
/// @throws DataError if the log of the run is not a street.toml
inline SyntheticOptions read_street_options_of_run(const TrainedRun& run) {
    const std::string dataset = run.config.dataset.path, prefix = "synthetic:";
    return read_synthetic_options(dataset.starts_with(prefix) ? dataset.substr(prefix.size()) : dataset);
}

}  // namespace relidar
