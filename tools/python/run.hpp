// SPDX-License-Identifier: Apache-2.0
// A run as Python holds it: with the device it renders on, and a renderer that is made
// when the first scan is wanted.
#pragma once

#include <optional>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include "device.hpp"

namespace relidar::python {

struct LoadedRun {
    Run run;
    SharedDevice device;  ///< null: the default one
    OnDevice<ScanRenderer> renderer{};

    /// The renderer of this run, which nothing else changes.
    OnDevice<ScanRenderer>& ready_renderer();
};

/// Writes a run into a folder, which becomes its own. @throws UsageError where a run is
/// there that is not to be overwritten, as save_run()
void save_to(Run& run, const std::filesystem::path& folder, bool overwrite);

}  // namespace relidar::python
