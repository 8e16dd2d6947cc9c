// SPDX-License-Identifier: Apache-2.0
// A folder for results, checked before the long work begins and not left behind empty where that work fails.
#pragma once

#include <filesystem>

namespace relidar::cli {

/// Makes a folder and proves that it can be written. Destruction removes it where it was made here and is still empty.
class OutputFolder {
public:
    /// @throws DataError where it cannot be made or written
    explicit OutputFolder(const std::filesystem::path& path);
    ~OutputFolder();
    OutputFolder(const OutputFolder&) = delete;
    OutputFolder& operator=(const OutputFolder&) = delete;

    const std::filesystem::path& path() const { return path_; }

private:
    std::filesystem::path path_;
    bool was_there_;
};

/// For a run: refuses a folder that holds something. @throws UsageError unless force is set
void check_empty(const std::filesystem::path& folder, bool force);
/// Removes the files of an earlier run but its settings and checkpoints, so that none is mistaken for one of this run, and what a killed one left
/// half written.
void remove_run_files(const std::filesystem::path& folder);
/// Where a run keeps its checkpoints.
std::filesystem::path checkpoint_folder(const std::filesystem::path& run);

}  // namespace relidar::cli
