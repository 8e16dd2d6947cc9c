// SPDX-License-Identifier: Apache-2.0
// A run as a Python object, together with its device. The renderer is created when Python
// requests the first scan.
#pragma once

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include "device.hpp"

namespace relidar::python {

struct LoadedRun {
    Run run;
    SharedDevice device;  ///< Device of the run. If the pointer is null, the default device is used.
    DeviceObject<ScanRenderer> renderer{};

    // Clang before 16 needs the constructor for make_unique().
    LoadedRun(Run r, SharedDevice d) : run(std::move(r)), device(std::move(d)) {}

    DeviceObject<ScanRenderer>& get_renderer();
};

void save_run_in(Run& run, const std::filesystem::path& folder, bool overwrite);

}  // namespace relidar::python
