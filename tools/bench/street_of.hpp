// SPDX-License-Identifier: Apache-2.0
// The synthetic street that a run was trained on.
#pragma once

#include <string>

#include <relidar/log/dataset.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

/// @throws DataError where the run's log is no street.toml
inline SyntheticOptions street_of(const Run& run) {
    const std::string dataset = run.config.dataset.path, prefix = "synthetic:";
    return read_synthetic(dataset.starts_with(prefix) ? dataset.substr(prefix.size()) : dataset);
}

}  // namespace relidar
