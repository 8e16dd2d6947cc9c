// SPDX-License-Identifier: Apache-2.0
// Loads synthetic logs. The file street.toml contains the options of a log. The scans are
// not stored, but generated again from the options.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Generates the log that folder/street.toml describes. The origin of the world is the
/// position of the sensor in the middle of the full log. This also applies if only a
/// range of frames is loaded, so that the world is the same as in
/// cast_rays_into_synthetic_street().
/// @throws DataError with the invalid key
/// @throws UsageError if no frame is in the requested range or a poses file is given
LidarSequence load_synthetic_dataset(const std::filesystem::path& folder, const DatasetOptions& options);

/// Generates the frames [begin, end) of the synthetic log that make_synthetic_street()
/// generates.
LidarSequence make_synthetic_frames(const SyntheticOptions& options, int begin_frame, int end_frame);

}  // namespace relidar
