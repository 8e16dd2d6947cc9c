// SPDX-License-Identifier: Apache-2.0
// Loads, saves and pickles runs. A pickle has the folder of a run if its files have the
// content of the run, otherwise the content of these files.
#include <algorithm>

#include <fmt/ranges.h>
#include <pybind11/stl.h>
#include "base/fail.hpp"

#include "conversions.hpp"
#include "run.hpp"

namespace relidar::python {
namespace {

namespace fs = std::filesystem;

/// Returns names, sizes and times of the files that contain a run, to detect later
/// whether they have changed. Empty without a folder.
std::string list_run_files(const fs::path& folder) {
    std::vector<std::string> files;
    std::error_code missing;
    for (const fs::directory_entry& file : fs::directory_iterator(folder, missing)) {
        const fs::path& path = file.path();
        if (path.extension() != ".safetensors" && path.filename() != "scene.json") continue;
        files.push_back(fmt::format("{} {} {}", path.filename().string(), file.file_size(),
                                    file.last_write_time().time_since_epoch().count()));
    }
    std::ranges::sort(files);
    return fmt::format("{}", fmt::join(files, "\n"));
}

py::object make_temp_folder() {
    return py::module_::import("tempfile").attr("TemporaryDirectory")(py::arg("prefix") = "relidar-");
}

py::object python_path(const py::handle& folder) {
    return py::module_::import("pathlib").attr("Path")(folder);
}

}  // namespace

std::unique_ptr<LoadedRun> load_run_with(const fs::path& folder, const py::dict& settings,
                                         const SharedDevice& device) {
    Run run = load_run(folder);
    set_values(run.config, settings);
    auto loaded = std::make_unique<LoadedRun>(std::move(run), device);
    loaded->files_on_disk = list_run_files(folder);
    return loaded;
}

/// Saves a run to a folder, which becomes the folder of the run. After an error, the run
/// keeps its previous folder.
void save_run_in(LoadedRun& loaded, const fs::path& folder, bool overwrite) {
    Run& run = loaded.run;
    if (!overwrite && is_run_folder(folder))
        fail<UsageError>(
            "cannot save to {}: the folder already contains a run; expected a new folder; "
            "overwrite=True replaces the run",
            folder.string());
    const fs::path before = std::exchange(run.folder, folder);
    try {
        save_run(run);
    } catch (...) {
        run.folder = before;
        throw;
    }
    loaded.files_on_disk = list_run_files(folder);
}

py::tuple pickle_run(const LoadedRun& loaded) {
    const py::object settings = py::cast(loaded.run.config).attr("values")();
    const fs::path& folder = loaded.run.folder;
    const std::string absolute = folder.empty() ? "" : fs::absolute(folder).lexically_normal().string();
    // If the folder still contains this run, the pickle needs only its path.
    if (!loaded.files_on_disk.empty() && loaded.files_on_disk == list_run_files(folder))
        return py::make_tuple(absolute, settings, loaded.files_on_disk, py::none());
    // Otherwise the pickle contains the files. They are first saved to a temporary
    // folder, with the surfels of all blocks.
    const py::object temporary = make_temp_folder();
    Run copy = loaded.run;
    copy.scene = with_all_blocks(copy.scene);
    copy.folder = fs::path(temporary.attr("name").cast<std::string>()) / "run";
    save_run(copy);
    py::dict files;
    for (const py::handle& file : python_path(py::cast(copy.folder.string())).attr("iterdir")())
        files[file.attr("name")] = file.attr("read_bytes")();
    temporary.attr("cleanup")();
    return py::make_tuple(absolute, settings, "", files);
}

/// Makes a run from a state of pickle_run(). Loads the folder of the run. If the state
/// has the contents of files, loads these, because they differ from those in the folder.
/// @throws DataError if the files in the folder have changed
std::unique_ptr<LoadedRun> unpickle_run(const py::tuple& state) {
    const auto [folder, settings, pickled_files, contents] =
        state.cast<std::tuple<std::string, py::dict, std::string, std::optional<py::dict>>>();
    const SharedDevice default_device;  // is null, and is created for the first rendering
    if (!contents) {
        auto loaded = load_run_with(folder, settings, default_device);
        if (loaded->files_on_disk == pickled_files) return loaded;
        fail("cannot unpickle the run {}: its files have changed since it was pickled", folder);
    }
    // Writes the contents to files of a temporary folder, as pathlib.Path.write_bytes().
    const py::object temporary = make_temp_folder();
    const py::object path = python_path(temporary.attr("name"));
    for (const auto& [name, content] : *contents) path.attr("joinpath")(name).attr("write_bytes")(content);
    Run run = load_run(temporary.attr("name").cast<std::string>());
    temporary.attr("cleanup")();
    set_values(run.config, settings);
    run.folder = folder;
    return std::make_unique<LoadedRun>(std::move(run), default_device);
}

}  // namespace relidar::python
