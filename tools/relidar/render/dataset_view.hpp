// SPDX-License-Identifier: Apache-2.0
// The options --camera, --fov and --classes of `relidar render --layout`, and the
// pictures of frames.
#pragma once

#include <string>

#include <CLI/CLI.hpp>

#include <relidar/log/log.hpp>
#include <relidar/simulate/dataset_layouts.hpp>

namespace relidar::cli {

struct DatasetViewOptions {
    std::string camera;   ///< empty: the front camera of the log, or the camera of the layout
    std::string fov;      ///< empty: the default of the layout
    std::string classes;  ///< file with names of classes, or empty
};

void add_view_options(CLI::App& command, DatasetViewOptions& options);

/// Rejects unknown values, and options without a layout.
void check_view_options(const DatasetViewOptions& options, const std::string& layout);

/// Returns the camera and the extent of a sequence.
/// @param lidar  index of the log's LiDAR whose frames are rendered
DatasetView choose_view(const DatasetViewOptions& options, const std::string& layout, const Log& log,
                        int lidar);

/// Prints a note if frames have points where the log has no labels.
void note_labelled_sector(const DatasetView& view);

}  // namespace relidar::cli
