// SPDX-License-Identifier: Apache-2.0
// Creates and locks output folders. A folder is checked before long work starts. If the
// work fails, an empty folder is removed.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>

namespace relidar {
struct Run;
}

namespace relidar::cli {

std::filesystem::path folder_of(const std::filesystem::path& file);

/// Creates a folder. The destructor removes it if it was created and is still empty.
class OutputFolder {
public:
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

/// Only one process at a time can write to a locked folder. The system releases the lock
/// when the process ends. Also removes half-written files of killed processes. Has no
/// effect if the file system does not support locks.
class FolderLock {
public:
    /// Locks the folder, so that no other relidar process writes to it.
    /// @param max_wait longest waiting time for another process
    /// @throws DataError after this time, or if the folder cannot be written
    explicit FolderLock(const std::filesystem::path& folder, std::chrono::milliseconds max_wait = {});
    ~FolderLock();
    FolderLock(const FolderLock&) = delete;
    FolderLock& operator=(const FolderLock&) = delete;

    /// @return null if another process holds the lock
    /// @throws DataError if the folder cannot be written
    static std::unique_ptr<FolderLock> try_lock_folder(const std::filesystem::path& folder);
    static bool is_locked(const std::filesystem::path& folder);

private:
    FolderLock(std::filesystem::path file, int descriptor);

    std::filesystem::path file_;
    int descriptor_;
};

/// Checks that scans can be written to a folder without replacing other files.
/// @throws UsageError if the folder is a run or a log, or contains files that would be
/// replaced; `overwrite` allows to replace rendered scans
void check_scan_folder(const std::filesystem::path& folder, bool overwrite);

class LockedFolder {
public:
    /// @throws UsageError for / and the home folder of the user
    /// @throws DataError if another process has locked the folder, or if it cannot be
    /// created
    explicit LockedFolder(const std::filesystem::path& path);

    const std::filesystem::path& path() const { return folder_.path(); }

private:
    OutputFolder folder_;
    /// Destroyed first, so that `folder_` can remove an empty folder.
    FolderLock lock_;
};

/// Also true after a training that was killed before it saved a scene.
bool contains_run(const std::filesystem::path& folder);

enum class ExistingRunPolicy {
    refuse,  ///< Throws an error if the folder is not empty.
    keep,    ///< Keeps the existing run. Training continues from its last checkpoint.
    replace  ///< Overwrites the existing run with the new run.
};

/// Stays locked as long as this object exists.
class RunOutputFolder {
public:
    /// @throws UsageError if `policy` does not allow the files in the folder
    /// @throws DataError if another process has locked the folder, or if it cannot be
    /// created
    RunOutputFolder(const std::filesystem::path& path, ExistingRunPolicy policy);
    /// Removes settings and log of a training that failed before it saved anything. After
    /// Ctrl-C they stay, because --resume needs them.
    ~RunOutputFolder();

    const std::filesystem::path& path() const { return folder_->path(); }

private:
    bool was_empty_;
    std::optional<OutputFolder> folder_;
    /// Destroyed first, so that `folder_` can remove an empty folder.
    std::optional<FolderLock> lock_;
};

/// A new folder appears under its name only when all files are written. The files of an
/// earlier run stay until then.
/// @throws UsageError if the folder contains other files, or a run that must not be
/// replaced
/// @throws DataError if another process has locked the folder, or if it cannot be written
class RunFolderWriter {
public:
    RunFolderWriter(const std::filesystem::path& path, bool replace_existing);
    /// Saves a run in the folder. If the folder contains only an earlier run, exchanges
    /// both folders, so that a killed process leaves one of the two runs complete.
    void save_run_in(Run& run) const;

private:
    std::filesystem::path path_;
    /// no value for a new folder
    std::optional<RunOutputFolder> earlier_;
};

void remove_results(const std::filesystem::path& folder);
void remove_blocks(const std::filesystem::path& run_folder);
/// Each block is stored as a complete run.
std::filesystem::path blocks_folder(const std::filesystem::path& run_folder);
std::filesystem::path checkpoint_folder(const std::filesystem::path& run_folder);
std::filesystem::path network_checkpoint_folder(const std::filesystem::path& run_folder);
void remove_network_state(const std::filesystem::path& run_folder);

}  // namespace relidar::cli
