// SPDX-License-Identifier: Apache-2.0
#include "output_folder.hpp"

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/export.hpp>
#include <relidar/run.hpp>

namespace relidar::cli {

namespace fs = std::filesystem;

OutputFolder::OutputFolder(const fs::path& path) : path_(path) {
    std::error_code failed;
    was_there_ = fs::exists(path, failed);
    check_writable(path);
}

OutputFolder::~OutputFolder() {
    std::error_code failed;
    if (!was_there_) fs::remove(path_, failed);   // refuses where something is in it
}

void check_empty(const fs::path& folder, bool force) {
    std::error_code failed;
    if (force || !fs::is_directory(folder, failed) || fs::is_empty(folder, failed)) return;
    throw UsageError(fmt::format("--out {}: the folder is not empty, expected a new one; --force overwrites the run in it", folder.string()));
}

void remove_run_files(const fs::path& folder) {
    std::error_code failed;
    for (const char* name : {"scene.json", "model.safetensors", "log.jsonl", "metrics.json", "report.html"}) fs::remove(folder / name, failed);
    remove_temporaries(folder);
    remove_temporaries(checkpoint_folder(folder));
}

fs::path checkpoint_folder(const fs::path& run) { return run / "checkpoints"; }

}  // namespace relidar::cli
