// SPDX-License-Identifier: Apache-2.0
// `relidar eval RUN RUN ... --table FILE`: the scores of several runs in one table.
#pragma once

#include <string>
#include <vector>

namespace relidar::cli {

/// Reads the metrics.json of each run and writes all scores into each file. Renders
/// nothing and needs no device.
/// @param runs run folders, in the order of the rows
/// @param files names of the files: FILE.md receives the key metrics and their means,
/// FILE.csv all metrics, and FILE.html both as a web page
/// @throws UsageError for another extension; DataError if a folder holds no run. If a run
/// has no scores, the files are still written, and then a DataError names the run.
void write_score_tables(const std::vector<std::string>& runs, const std::vector<std::string>& files);

}  // namespace relidar::cli
