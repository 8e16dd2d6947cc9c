// SPDX-License-Identifier: Apache-2.0
// Reader of a synthetic log's folder: street.toml with the options it was made with;
// everything else is computed again.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Makes the log that folder/street.toml describes. The world's origin is the sensor in
/// the middle of the whole log, also where a range of its frames is read, so that
/// cast_synthetic_street speaks of the same world.
/// @throws DataError naming the key that is wrong, UsageError where no frame lies in the
/// range or a poses file is given
Sequence load_synthetic(const std::filesystem::path& folder, const DatasetOptions& options);

/// Frames [begin, end) of the log of make_synthetic_street.
Sequence make_synthetic_frames(const SyntheticOptions& options, int begin, int end);

}  // namespace relidar
