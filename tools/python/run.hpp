// SPDX-License-Identifier: Apache-2.0
// A run as a Python object, with its device, and a renderer that is created when the
// first scan is requested.
#pragma once

#include <optional>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include "device.hpp"

namespace relidar::python {

struct LoadedRun {
    Run run;
    SharedDevice device;  ///< Null: the default device.
    OnDevice<ScanRenderer> renderer{};

    /// Returns the renderer of this run and creates it if necessary. No other object
    /// modifies it.
    OnDevice<ScanRenderer>& ready_renderer();
};

/// Writes a run into a folder and sets `run.folder` to it.
/// @throws UsageError if the folder holds a run that must not be overwritten, as
/// save_run()
void save_to(Run& run, const std::filesystem::path& folder, bool overwrite);

}  // namespace relidar::python
