// SPDX-License-Identifier: Apache-2.0
// The option `relidar eval RUN RUN ... --table FILE` writes the scores of several runs
// into one table.
#pragma once

#include <string>
#include <vector>

namespace relidar::cli {

/// Reads metrics.json of each run and writes the scores of all runs into each file.
/// Renders nothing and needs no device. If a run has no scores, the files are written
/// first, and then a DataError is thrown.
/// @param runs run folders, in the order of the rows
/// @param files output files: FILE.md receives the means of the key metrics, FILE.csv all
/// metrics, and FILE.html both as a web page
/// @throws UsageError if a file has another extension; DataError if a folder holds no run
/// or a run has no scores
void write_score_tables(const std::vector<std::string>& runs, const std::vector<std::string>& files);

}  // namespace relidar::cli
