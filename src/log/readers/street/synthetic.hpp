// SPDX-License-Identifier: Apache-2.0
// Reader of a synthetic log: street.toml has the options of the log, and everything else
// is computed again.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Generates the log that folder/street.toml describes. The world's origin is the sensor
/// position in the middle of the full log, even if only a range of frames is read. So
/// cast_synthetic_street() uses the same world.
/// @throws DataError with the invalid key, UsageError if no frame is in the range or a
/// poses file is given
Sequence load_synthetic(const std::filesystem::path& folder, const DatasetOptions& options);

/// Generates frames [begin, end) of the log of make_synthetic_street().
Sequence make_synthetic_frames(const SyntheticOptions& options, int begin, int end);

}  // namespace relidar
