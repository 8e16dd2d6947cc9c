// SPDX-License-Identifier: Apache-2.0
// Reads which synthetic street a run was trained on.
#pragma once

#include <string>

#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

/// Returns the options of the synthetic street on which a run was trained.
/// @throws DataError if the log of the run is not a street.toml
inline StreetOptions read_street(const Run& run) {
    const std::string dataset = run.config.dataset.path, prefix = "synthetic:";
    return load_street(dataset.starts_with(prefix) ? dataset.substr(prefix.size()) : dataset);
}

}  // namespace relidar
