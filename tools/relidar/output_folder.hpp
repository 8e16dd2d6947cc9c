// SPDX-License-Identifier: Apache-2.0
// Folders for results, checked before the long work begins and not left behind empty
// where that work fails.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>

namespace relidar {
struct Run;
}

namespace relidar::cli {

/// Makes a folder and proves that it can be written. Destruction removes it where it was
/// made here and is still empty.
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

/// Only one process at a time writes a folder. The system releases a lock when the
/// process that holds it ends. On a file system without locks nobody is kept out. The
/// constructor removes what a killed process has left half written.
class FolderLock {
public:
    /// @param patience  how long it waits for another process that holds it
    /// @throws DataError where another process holds it still, or the folder cannot be
    /// written
    explicit FolderLock(const std::filesystem::path& folder, std::chrono::milliseconds patience = {});
    ~FolderLock();
    FolderLock(const FolderLock&) = delete;
    FolderLock& operator=(const FolderLock&) = delete;

    /// @return nothing where another process holds it @throws DataError where the folder
    /// cannot be written
    static std::unique_ptr<FolderLock> take_if_free(const std::filesystem::path& folder);
    /// Whether some process holds it. Writes nothing.
    static bool is_held(const std::filesystem::path& folder);

private:
    FolderLock(std::filesystem::path file, int descriptor);

    std::filesystem::path file_;
    int descriptor_;
};

/// A folder for results that this process alone writes.
class LockedFolder {
public:
    /// @throws DataError if another process writes it, or it cannot be made or written
    explicit LockedFolder(const std::filesystem::path& path) : folder_(path), lock_(path) {}

    const std::filesystem::path& path() const { return folder_.path(); }

private:
    OutputFolder folder_;
    FolderLock lock_;  ///< goes first: an empty folder can be removed
};

/// Whether a folder holds a run, or what one leaves that was killed before it had a
/// scene.
bool holds_run(const std::filesystem::path& folder);

/// What may be in the folder of a run that is about to be written.
enum class Existing {
    refuse,  ///< nothing
    keep,    ///< nothing, or a run that goes on
    replace  ///< nothing, or a run that is given up
};

/// The folder of a run, written by this process alone for as long as this lives.
class RunFolder {
public:
    /// @throws UsageError where something else is in it, DataError where another process
    /// writes it or it cannot be made
    RunFolder(const std::filesystem::path& path, Existing existing);

    const std::filesystem::path& path() const { return folder_->path(); }

private:
    std::optional<OutputFolder> folder_;
    std::optional<FolderLock> lock_;  ///< goes first: an empty folder can be removed
};

/// Saves a run as a folder. A new folder appears complete or not at all. An earlier run
/// in it stays until all files are written.
/// @throws UsageError if the folder holds something else, or a run that is not to be
/// replaced; DataError if another process writes it, or it cannot be written
class NewRun {
public:
    NewRun(const std::filesystem::path& path, bool replace);
    /// Makes the folder the run's own.
    void save(Run& run) const;

private:
    std::filesystem::path path_;
    std::optional<RunFolder> earlier_;  ///< of a folder that exists already
};

/// Removes the files of an earlier run but its settings and checkpoints, so that none is
/// mistaken for one of this run.
void remove_run_files(const std::filesystem::path& folder);
/// Removes the blocks of a long scene, trained or begun.
void remove_blocks(const std::filesystem::path& folder);
/// Where a run keeps its blocks, each a run of its own.
std::filesystem::path blocks_folder(const std::filesystem::path& run);
/// Where a run keeps its checkpoints, and those of its ray-drop network.
std::filesystem::path checkpoint_folder(const std::filesystem::path& run);
std::filesystem::path network_checkpoint_folder(const std::filesystem::path& run);
/// Removes those of the network.
void remove_network_checkpoints(const std::filesystem::path& run);

}  // namespace relidar::cli
