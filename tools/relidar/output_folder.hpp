// SPDX-License-Identifier: Apache-2.0
// Creates and locks output folders. A folder is checked before long work starts. If the
// work fails, an empty folder is removed.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>

namespace relidar {
struct TrainedRun;
}

namespace relidar::cli {

/// Creates a folder and checks that it is writable. The destructor removes the folder if
/// this object created it and it is still empty.
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

/// Locks a folder, so that only one process at a time can write to it. The system
/// releases the lock when the process ends. The constructor also removes half-written
/// files of killed processes. The class has no effect if the file system does not support
/// locks.
class FolderLock {
public:
    /// Locks a folder. Waits if another process holds the lock.
    /// @param max_wait_time longest waiting time
    /// @throws DataError if another process still holds the lock after this time, or if
    /// the folder cannot be written
    explicit FolderLock(const std::filesystem::path& folder, std::chrono::milliseconds max_wait_time = {});
    ~FolderLock();
    FolderLock(const FolderLock&) = delete;
    FolderLock& operator=(const FolderLock&) = delete;

    /// Locks a folder without waiting.
    /// @return null if another process holds the lock
    /// @throws DataError if the folder cannot be written
    static std::unique_ptr<FolderLock> try_lock_folder(const std::filesystem::path& folder);
    /// Returns true if a process holds the lock of the folder. Does not change any file.
    static bool is_folder_locked(const std::filesystem::path& folder);

private:
    FolderLock(std::filesystem::path file, int descriptor);

    std::filesystem::path file_;
    int descriptor_;
};

/// Checks that rendered scans can be written to a folder.
/// @throws UsageError if the folder is a run or a log, or if it contains files that would
/// be replaced. Rendered scans may be replaced if `overwrite` is true.
void require_folder_for_scans(const std::filesystem::path& folder, bool overwrite);

/// An output folder that no other process can write to, because it is locked.
class LockedFolder {
public:
    /// Creates the folder if it does not exist, and locks it.
    /// @throws UsageError for / and the home folder of the user
    /// @throws DataError if another process has locked the folder, or if the folder
    /// cannot be created or written
    explicit LockedFolder(const std::filesystem::path& path);

    const std::filesystem::path& path() const { return folder_.path(); }

private:
    OutputFolder folder_;
    /// Declared last, so that it is destroyed first and removes the lock file. The
    /// destructor of `folder_` then removes the folder if it is empty.
    FolderLock lock_;
};

/// Returns true if a folder contains a trained run. Also returns true if it contains
/// files of a training that was killed before it saved a scene.
bool contains_run(const std::filesystem::path& folder);

/// Says what to do if the output folder already contains a trained run.
enum class ExistingRunPolicy {
    refuse,  ///< Throws an error if the folder is not empty.
    keep,    ///< Keeps the existing run. Training continues from its last checkpoint.
    replace  ///< Overwrites the existing run with the new run.
};

/// Output folder of a run. The folder stays locked as long as this object exists, so that
/// no other process writes to it.
class RunOutputFolder {
public:
    /// Checks the content of the folder, creates the folder if it does not exist, and
    /// locks it.
    /// @throws UsageError if `existing_run_policy` does not allow the files in the folder
    /// @throws DataError if another process has locked the folder, or if the folder
    /// cannot be created
    RunOutputFolder(const std::filesystem::path& path, ExistingRunPolicy existing_run_policy);
    /// If the folder was empty and a training has failed before it saved a scene or a
    /// checkpoint, removes its settings and its log. After Ctrl-C they stay.
    ~RunOutputFolder();

    const std::filesystem::path& path() const { return folder_->path(); }

private:
    bool was_empty_;
    std::optional<OutputFolder> folder_;
    /// Declared last, so that it is destroyed first and removes the lock file. The
    /// destructor of `folder_` then removes the folder if it is empty.
    std::optional<FolderLock> lock_;
};

/// Saves a run as a folder. A new folder appears under its name only when all its files
/// are written. The files of an earlier run stay until all new files are written.
/// @throws UsageError if the folder contains other files, or a run that must not be
/// replaced
/// @throws DataError if another process has locked the folder, or if the folder cannot be
/// written
class RunFolderWriter {
public:
    RunFolderWriter(const std::filesystem::path& path, bool replace_existing);
    /// Writes the run and sets `run.folder` to this folder.
    void save_run_to_folder(TrainedRun& run) const;

private:
    std::filesystem::path path_;
    /// Lock of the output folder if the folder already existed. Has no value for a new
    /// folder.
    std::optional<RunOutputFolder> earlier_;
};

/// Removes the result files of an earlier run, so that nobody mistakes them for results
/// of the new run. Keeps the settings and the checkpoints.
void remove_run_result_files(const std::filesystem::path& folder);
/// Removes the folders of all blocks of a long scene, even if their training is finished.
void remove_block_folders(const std::filesystem::path& run_folder);
/// Returns the folder that contains the blocks of a run. Each block is stored as a
/// complete run.
std::filesystem::path get_blocks_folder(const std::filesystem::path& run_folder);
/// These two functions return the folders of checkpoints. The first folder is for the
/// scene, and the second is for the ray-drop network.
std::filesystem::path get_checkpoint_folder(const std::filesystem::path& run_folder);
std::filesystem::path get_network_checkpoint_folder(const std::filesystem::path& run_folder);
/// Removes the checkpoints of the ray-drop network.
void remove_network_checkpoints(const std::filesystem::path& run_folder);

}  // namespace relidar::cli
