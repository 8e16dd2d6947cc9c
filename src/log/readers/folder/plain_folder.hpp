// SPDX-License-Identifier: Apache-2.0
// A plain folder: sequence.json, poses.txt, boxes.json, scans; what people write from
// their own logs, and `relidar convert` from any other.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// @throws DataError naming file and field
Sequence load_plain_folder(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
