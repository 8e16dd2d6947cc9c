// SPDX-License-Identifier: Apache-2.0
// `relidar tables`: what its jobs have reached, beside the published numbers, as Markdown and CSV.
#pragma once

#include <string>
#include <vector>

#include "batch/summary.hpp"
#include "tables/plan.hpp"

namespace relidar::cli {

/// What is known of a row.
struct TableResult {
    const TableEntry* entry = nullptr;
    std::string state;  ///< "done"; else why there are no numbers, or not yet
    /// As metrics.json has them, and "fps", "memory_gb", "seconds_per_scan", "training_s", "all_s", "frames"; empty: none yet
    MetricRow values;
    std::string device;  ///< that scored it
    std::string lacks;     ///< what the part should have and had not: frames, labels; empty: nothing
};

/// @param reports  of the jobs of the entries that are not missing
std::vector<TableResult> collect_results(const std::vector<TableEntry>& entries, const std::vector<JobReport>& reports);

/// Both tables and, where it was asked for, the ablation. @param command_line  that made them
std::string tables_markdown(const std::vector<TableResult>& results, const TablesOptions& options, const std::string& command_line);

/// The rows of one dataset, published ones first, and every number that there is. @param kind  "waymo" or "kitti360"
/// @param changes  the ablation's rows instead of the others
std::string table_csv(const std::vector<TableResult>& results, const std::string& kind, bool changes);

}  // namespace relidar::cli
