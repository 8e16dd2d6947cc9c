// SPDX-License-Identifier: Apache-2.0
// coverage.safetensors: where the training scans of a run have looked. Private to run.
#pragma once

#include <filesystem>

#include <relidar/log/coverage.hpp>

namespace relidar::run_detail {

/// Arrays `place` [blocks,3] i4, in blocks, and `cells` [blocks,32] u2 (Coverage::Cells).
/// An empty set: no file.
void save_coverage(const std::filesystem::path& path, const Coverage& coverage);
/// @throws DataError for arrays that are missing or misshapen, and for cells of another
/// size
Coverage load_coverage(const std::filesystem::path& path);

}  // namespace relidar::run_detail
