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
    /// Sizes and times of the files in `run.folder` if they have the content of this run,
    /// otherwise empty.
    std::string files_on_disk = {};

    // Clang before 16 needs the constructor for make_unique().
    LoadedRun(Run r, SharedDevice d) : run(std::move(r)), device(std::move(d)) {}

    DeviceObject<ScanRenderer>& get_renderer();
};

std::unique_ptr<LoadedRun> load_run_with(const std::filesystem::path& folder, const py::dict& settings,
                                         const SharedDevice& device);
void save_run_in(LoadedRun& run, const std::filesystem::path& folder, bool overwrite);
/// Returns the state of a run: folder, settings, list of its files, and the content of
/// the files or None.
py::tuple pickle_run(const LoadedRun& loaded);
/// @throws DataError if the files in the folder have changed
std::unique_ptr<LoadedRun> unpickle_run(const py::tuple& state);

}  // namespace relidar::python
