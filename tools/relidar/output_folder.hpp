// SPDX-License-Identifier: Apache-2.0
// Output folders. They are checked before long work starts, and removed if the work fails
// and leaves them empty.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>

namespace relidar {
struct Run;
}

namespace relidar::cli {

/// Creates a folder and checks that it is writable. The destructor removes the folder if
/// the constructor created it and it is still empty.
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

/// Lock that lets only one process at a time write a folder. The system releases the lock
/// when its process ends. On a file system without locks, the lock has no effect. The
/// constructor removes half-written files that a killed process has left behind.
class FolderLock {
public:
    /// Locks a folder.
    /// @param patience longest time to wait for another process to release the lock
    /// @throws DataError if another process still holds the lock after that time, or the
    /// folder cannot be written
    explicit FolderLock(const std::filesystem::path& folder, std::chrono::milliseconds patience = {});
    ~FolderLock();
    FolderLock(const FolderLock&) = delete;
    FolderLock& operator=(const FolderLock&) = delete;

    /// Locks a folder if no other process holds the lock. Does not wait.
    /// @return a null pointer if another process holds the lock
    /// @throws DataError if the folder cannot be written
    static std::unique_ptr<FolderLock> take_if_free(const std::filesystem::path& folder);
    /// Returns true if any process holds the lock. Writes nothing.
    static bool is_held(const std::filesystem::path& folder);

private:
    FolderLock(std::filesystem::path file, int descriptor);

    std::filesystem::path file_;
    int descriptor_;
};

/// An output folder that only this process may write.
class LockedFolder {
public:
    /// Creates the folder if it does not exist, and locks it.
    /// @throws DataError if another process is writing the folder, or the folder cannot
    /// be created or written
    explicit LockedFolder(const std::filesystem::path& path) : folder_(path), lock_(path) {}

    const std::filesystem::path& path() const { return folder_.path(); }

private:
    OutputFolder folder_;
    FolderLock lock_;  ///< Destroyed first, so that an empty folder can be removed.
};

/// Returns true if a folder holds a run, or the files of a training that was killed
/// before it saved a scene.
bool holds_run(const std::filesystem::path& folder);

/// What a run's folder may contain before the run is written.
enum class Existing {
    refuse,  ///< The folder must be empty.
    keep,    ///< The folder may hold a run, which is continued.
    replace  ///< The folder may hold a run, which is overwritten.
};

/// A run's folder that only this process may write during the lifetime of this object.
class RunFolder {
public:
    /// Checks the content of the folder, creates it if it does not exist, and locks it.
    /// @throws UsageError if the folder holds anything that `existing` does not permit;
    /// DataError if another process is writing the folder or it cannot be created
    RunFolder(const std::filesystem::path& path, Existing existing);

    const std::filesystem::path& path() const { return folder_->path(); }

private:
    std::optional<OutputFolder> folder_;
    std::optional<FolderLock> lock_;  ///< Destroyed first, so that an empty folder can be removed.
};

/// Saves a run as a folder. A new folder appears complete or not at all. An earlier run
/// in the folder stays until all new files are written.
/// @throws UsageError if the folder holds other files, or a run that must not be
/// replaced; DataError if another process is writing the folder or it cannot be written
class NewRun {
public:
    NewRun(const std::filesystem::path& path, bool replace);
    /// Saves the run and sets `run.folder` to this folder.
    void save(Run& run) const;

private:
    std::filesystem::path path_;
    std::optional<RunFolder> earlier_;  ///< Lock on the folder if it exists already.
};

/// Removes the files of an earlier run except its settings and checkpoints, so that they
/// are not mistaken for results of this run.
void remove_run_files(const std::filesystem::path& folder);
/// Removes all blocks of a long scene, finished or not.
void remove_blocks(const std::filesystem::path& folder);
/// Returns the folder of a run's blocks. Each block is a complete run.
std::filesystem::path blocks_folder(const std::filesystem::path& run);
/// Returns the folder of a run's checkpoints. The next function returns the folder for
/// the checkpoints of its ray-drop network.
std::filesystem::path checkpoint_folder(const std::filesystem::path& run);
std::filesystem::path network_checkpoint_folder(const std::filesystem::path& run);
/// Removes the checkpoints of the ray-drop network.
void remove_network_checkpoints(const std::filesystem::path& run);

}  // namespace relidar::cli
