// SPDX-License-Identifier: Apache-2.0
// A run as a Python object, together with its device. The renderer is created when Python
// requests the first scan.
#pragma once

#include <optional>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include "device.hpp"

namespace relidar::python {

struct LoadedRun {
    TrainedRun run;
    SharedDevice device;  ///< Device of the run. If the pointer is null, the default device is used.
    DeviceObject<ScanRenderer> renderer{};

    // Clang before 16 needs the constructor for make_unique().
    LoadedRun(TrainedRun trained_run, SharedDevice device_or_null)
        : run(std::move(trained_run)), device(std::move(device_or_null)) {}

    /// Returns the renderer of this run. Creates the renderer at the first call. No other
    /// object uses this renderer.
    DeviceObject<ScanRenderer>& get_renderer();
};

/// Saves a run in a folder and sets `run.folder` to this folder.
/// @throws UsageError if `overwrite` is false and the folder already contains a run
void save_run_to_folder(TrainedRun& run, const std::filesystem::path& folder, bool overwrite);

}  // namespace relidar::python
