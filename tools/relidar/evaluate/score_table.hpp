// SPDX-License-Identifier: Apache-2.0
// Writes the scores of several runs into one table, for the command `relidar eval RUN RUN
// ... --table FILE`.
#pragma once

#include <string>
#include <vector>

namespace relidar::cli {

/// Reads the scores of each run from metrics.json and writes the scores of all runs into
/// each file. Needs no device. If a run has no scores, throws a DataError after the files
/// are written.
/// @param run_folders run folders, in the order of the rows
/// @param output_files output files: FILE.md receives the means of the key metrics,
/// FILE.csv all metrics, and FILE.html both as a web page
/// @throws UsageError if a file has another extension
/// @throws DataError if a folder contains no run, or a run has no scores
void write_score_tables(const std::vector<std::string>& run_folders,
                        const std::vector<std::string>& output_files);

}  // namespace relidar::cli
