// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace relidar::cli {

/// Writes the existing scores of several runs as tables. If a run has no scores, throws
/// after the files are written.
/// @param output_files FILE.md receives the means of the key metrics, FILE.csv all
/// metrics, and FILE.html both as a web page
/// @throws UsageError if a file has another extension
/// @throws DataError if a folder contains no run, or a run has no scores
void write_tables(const std::vector<std::string>& run_folders, const std::vector<std::string>& output_files);

}  // namespace relidar::cli
