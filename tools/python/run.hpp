// SPDX-License-Identifier: Apache-2.0
// A run as a Python object, together with its device. Its renderer is created when the
// first scan is requested.
#pragma once

#include <optional>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include "device.hpp"

namespace relidar::python {

struct LoadedRun {
    Run run;
    SharedDevice device;  ///< Device of the run. If it is null, the default device is used.
    OnDevice<ScanRenderer> renderer{};

    /// Returns the renderer of this run. Creates the renderer at the first call. No other
    /// object changes the renderer.
    OnDevice<ScanRenderer>& ready_renderer();
};

/// Saves a run in a folder and sets `run.folder` to this folder.
/// @throws UsageError if `overwrite` is false and the folder already holds a run, as in
/// save_run()
void save_to(Run& run, const std::filesystem::path& folder, bool overwrite);

}  // namespace relidar::python
