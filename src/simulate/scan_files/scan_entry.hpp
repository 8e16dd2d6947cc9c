// SPDX-License-Identifier: Apache-2.0
// Writes the entries of the file scans.json, and removes the files of an earlier
// rendering.
#pragma once

#include <relidar/simulate/scan_files.hpp>

namespace relidar::scan_files {

/// Has the boxes of actors if their visibility was computed.
std::string entry_json(int frame, const RenderedScan& scan, const ScanOutputOptions& format,
                       const std::vector<std::string>& files);

/// Also removes half-written files of a killed process.
/// @throws DataError if a file cannot be removed
void remove_scans(const std::filesystem::path& folder);
/// For a folder without single scans.
void write_recordings(const std::filesystem::path& folder, const std::vector<std::string>& names);

}  // namespace relidar::scan_files
