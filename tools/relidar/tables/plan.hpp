// SPDX-License-Identifier: Apache-2.0
// `relidar tables`: the parts of the paper as jobs of a batch.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/dataset.hpp>
#include "batch/manifest.hpp"
#include "options.hpp"
#include "tables/published_numbers.hpp"

namespace relidar::cli {

struct TablesOptions {
    std::string tables;           ///< whose: "paper"
    std::string kitti360, waymo;  ///< datasets; empty: not at hand
    std::string out;
    std::string parts;              ///< names parted by commas; empty: all of the datasets at hand
    std::string presets = "paper";  ///< names parted by commas
    std::vector<std::string> sets;  ///< "key=value", over each preset
    std::string lpips;              ///< file of weights; empty: those that RELIDAR_LPIPS_WEIGHTS names, or no LPIPS
    bool ablation = false, retry_failed = false, quiet = false;
    DeviceChoice device;
};

/// One row: a part of the paper, trained by a preset, or by it with one change.
struct TableEntry {
    PublishedPart part;
    std::string preset;
    const Ablation* change = nullptr;  ///< nothing: the preset as it is
    BatchJob job;                      ///< that makes it; of an entry that is another's run, that one's
    std::filesystem::path scores;      ///< metrics.json that it makes
    std::string missing;               ///< why it cannot be made; empty: it can

    std::filesystem::path folder(const std::filesystem::path& out) const { return out / job.name; }
};

/// All rows that are asked for, those that cannot be made too. Reads no scan.
/// @throws UsageError for a part or preset that is not known, and where no dataset is given
std::vector<TableEntry> plan_tables(const TablesOptions& options);

/// The manifest of a batch that makes them: DIR/parts.toml for `relidar batch`.
std::string manifest_text(const std::vector<TableEntry>& entries);

}  // namespace relidar::cli
