// SPDX-License-Identifier: Apache-2.0
// Creates and locks output folders. A folder is checked before long work starts. It is
// removed if the work fails and the folder is empty.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>

namespace relidar {
struct Run;
}

namespace relidar::cli {

/// Creates a folder and checks that it is writable. The destructor removes a new folder
/// if it is still empty.
class OutputFolder {
public:
    /// Creates the folder if it does not exist.
    /// @throws DataError if the folder cannot be created or written
    explicit OutputFolder(const std::filesystem::path& path);
    ~OutputFolder();
    OutputFolder(const OutputFolder&) = delete;
    OutputFolder& operator=(const OutputFolder&) = delete;

    const std::filesystem::path& path() const { return path_; }

private:
    std::filesystem::path path_;
    bool was_there_;
};

/// Locks a folder, so that only one process at a time writes it. If a process ends, the
/// system releases its lock. If the file system does not support locks, this class does
/// nothing. The constructor removes half-written files that a killed process has left
/// behind.
class FolderLock {
public:
    /// Locks a folder.
    /// @param patience longest time to wait for another process to release the lock
    /// @throws DataError if another process still holds the lock after this time, or if
    /// the folder cannot be written
    explicit FolderLock(const std::filesystem::path& folder, std::chrono::milliseconds patience = {});
    ~FolderLock();
    FolderLock(const FolderLock&) = delete;
    FolderLock& operator=(const FolderLock&) = delete;

    /// Locks a folder if no other process holds the lock. Does not wait.
    /// @return null if another process holds the lock
    /// @throws DataError if the folder cannot be written
    static std::unique_ptr<FolderLock> try_lock(const std::filesystem::path& folder);
    /// Returns true if a process holds the lock of the folder. Does not change the
    /// folder.
    static bool is_held(const std::filesystem::path& folder);

private:
    FolderLock(std::filesystem::path file, int descriptor);

    std::filesystem::path file_;
    int descriptor_;
};

/// An output folder that is locked, so that no other process writes it.
class LockedFolder {
public:
    /// Creates the folder if it does not exist, and locks it.
    /// @throws DataError if another process is writing the folder, or the folder cannot
    /// be created or written
    explicit LockedFolder(const std::filesystem::path& path) : folder_(path), lock_(path) {}

    const std::filesystem::path& path() const { return folder_.path(); }

private:
    OutputFolder folder_;
    /// Members are destroyed in reverse order. The lock file is removed first, so that an
    /// empty folder can be removed.
    FolderLock lock_;
};

/// Returns true if a folder holds a run, or files of a training that was killed before it
/// saved a scene.
bool holds_run(const std::filesystem::path& folder);

/// States what the folder of a run may contain before the run is written.
enum class Existing {
    refuse,  ///< An error is thrown if the folder is not empty.
    keep,    ///< The folder may hold a run. Training continues this run.
    replace  ///< The folder may hold a run. The new run overwrites it.
};

/// Folder of a run. It is locked during the lifetime of this object, so that no other
/// process writes it.
class RunFolder {
public:
    /// Checks the content of the folder, creates the folder if it does not exist, and
    /// locks it.
    /// @throws UsageError if the folder contains files that `existing` does not allow;
    /// DataError if another process is writing the folder, or if it cannot be created
    RunFolder(const std::filesystem::path& path, Existing existing);

    const std::filesystem::path& path() const { return folder_->path(); }

private:
    std::optional<OutputFolder> folder_;
    /// Members are destroyed in reverse order. The lock file is removed first, so that an
    /// empty folder can be removed.
    std::optional<FolderLock> lock_;
};

/// Saves a run as a folder. If the folder is new, it appears only when it is complete. If
/// it contains an earlier run, that run stays until all new files are written.
/// @throws UsageError if the folder contains other files, or a run that must not be
/// replaced; DataError if another process is writing the folder, or if it cannot be
/// written
class NewRun {
public:
    NewRun(const std::filesystem::path& path, bool replace);
    /// Saves the run and sets `run.folder` to this folder.
    void save(Run& run) const;

private:
    std::filesystem::path path_;
    /// Lock of the folder. It has no value if the folder does not exist yet.
    std::optional<RunFolder> earlier_;
};

/// Removes the files of an earlier run, so that they are not mistaken for results of the
/// new run. Keeps the settings and the checkpoints.
void remove_run_files(const std::filesystem::path& folder);
/// Removes the folders of all blocks of a long scene. Finished blocks are removed too.
void remove_blocks(const std::filesystem::path& folder);
/// Returns the folder that contains the blocks of a run. Each block is stored as a
/// complete run.
std::filesystem::path blocks_folder(const std::filesystem::path& run);
/// Return the folders of checkpoints: the first for the scene, the second for the
/// ray-drop network.
std::filesystem::path checkpoint_folder(const std::filesystem::path& run);
std::filesystem::path network_checkpoint_folder(const std::filesystem::path& run);
/// Removes the checkpoints of the ray-drop network.
void remove_network_checkpoints(const std::filesystem::path& run);

}  // namespace relidar::cli
