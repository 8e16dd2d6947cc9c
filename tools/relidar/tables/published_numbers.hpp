// SPDX-License-Identifier: Apache-2.0
// What the LiDAR-RT paper prints: its Tables 1 and 2, and its ablations (Table 3 and those of its supplement).
#pragma once

#include <span>
#include <string>

#include <relidar/metrics.hpp>

namespace relidar::cli {

/// A row of a printed table. Values go by the names of our metrics (peer/depth_rmse_m, ...), and "fps", "memory_gb".
struct PublishedRow {
    std::string method;
    MetricRow values;
};
/// @param kind  of the dataset: "waymo" (Table 1) or "kitti360" (Table 2); the paper itself is the last row
std::span<const PublishedRow> published_rows(const std::string& kind);

/// A row of the paper's ablations, on dynamic parts of KITTI-360, and what it is here.
struct Ablation {
    std::string name;     ///< of folders: "no_chamfer"; rows of one name are one run
    std::string title;    ///< as the paper has it
    std::string setting;  ///< key=value over the preset; empty: the preset's run, scored without its network
    MetricRow values;     ///< as printed
};
std::span<const Ablation> ablations();

}  // namespace relidar::cli
