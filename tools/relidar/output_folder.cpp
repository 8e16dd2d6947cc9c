// SPDX-License-Identifier: Apache-2.0
#include "output_folder.hpp"
#include "base/fail.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <fstream>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <relidar/base/files.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/run/config.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/dataset_layouts.hpp>
#include <relidar/simulate/scan_files.hpp>
#include <relidar/train/train.hpp>
#include "interrupt.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::milliseconds kLockPollInterval{50};
/// mpirun and batch systems may restart a job before all old processes have ended.
constexpr std::chrono::milliseconds kEndOfOthers{5000};

constexpr const char* kLockFile = ".lock";

/// An unlocked lock file or a half-written temporary file of a killed process.
bool is_leftover(const fs::path& path) {
    const std::string name = path.filename().string();
    return name == kLockFile || (name.starts_with('.') && name.find(".tmp-") != std::string::npos);
}

/// Ignores leftover files of killed processes. True if the folder cannot be read, because
/// a later write reports that error.
bool is_free_folder(const fs::path& folder) {
    std::error_code failed;
    for (fs::directory_iterator entry(folder, failed), end; !failed && entry != end;
         entry.increment(failed)) {
        if (!is_leftover(entry->path())) return false;
    }
    return true;
}

/// Rejects a folder whose files a new run must not replace.
void check_folder(const fs::path& folder, ExistingRunPolicy existing_run_policy) {
    if (is_free_folder(folder)) return;
    if (is_dataset(folder))
        fail<UsageError>("--out {}: this folder contains a log; choose a different folder for the run",
                         folder.string());
    if (!contains_run(folder))
        fail<UsageError>(
            "--out {}: the folder is not empty and contains no run; expected a new or empty folder",
            folder.string());
    if (existing_run_policy == ExistingRunPolicy::refuse)
        fail<UsageError>("--out {}: the folder contains a run; expected a new folder, or --force",
                         folder.string());
}

void remove_temporary(const fs::path& folder) {
    for (const fs::path& in : {folder, checkpoint_folder(folder), network_checkpoint_folder(folder)})
        remove_temp(in);
}

/// Returns true if the path still names the open file. Another process may have removed
/// the lock file and created a new one.
bool is_still_at(int file_descriptor, const fs::path& expected_path) {
    struct stat opened {
    }, named{};
    return ::fstat(file_descriptor, &opened) == 0 && ::stat(expected_path.c_str(), &named) == 0 &&
           opened.st_dev == named.st_dev && opened.st_ino == named.st_ino;
}

/// Returns the folder. Rejects / and the home folder, whose files could be replaced.
const fs::path& reject_home(const fs::path& folder) {
    const char* home = std::getenv("HOME");
    std::error_code failed;
    for (const fs::path& other : {fs::path("/"), fs::path(home ? home : "/")})
        if (fs::equivalent(folder, other, failed))
            fail<UsageError>("--out {}: this is {}; expected a folder for the output", folder.string(),
                             other == "/" ? "the root folder" : "a home folder");
    return folder;
}

struct OpenLockFile {
    int descriptor;
    /// false if the file system does not support locks
    bool exclusive;
};

/// Opens a file and locks it. Tries again if another process has just removed the file,
/// because nobody else sees a lock on a removed file.
/// @return no value if another process holds the lock
std::optional<OpenLockFile> lock_file(const fs::path& file) {
    for (;;) {
        const int descriptor = ::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
        if (descriptor < 0)
            fail("cannot write {}: {}", file.string(), std::generic_category().message(errno));
        const bool is_locked = ::flock(descriptor, LOCK_EX | LOCK_NB) == 0;
        const bool is_held_elsewhere = !is_locked && errno == EWOULDBLOCK;
        if (!is_held_elsewhere && is_still_at(descriptor, file)) return OpenLockFile{descriptor, is_locked};
        ::close(descriptor);
        if (is_held_elsewhere) return std::nullopt;
    }
}

}  // namespace

fs::path folder_of(const fs::path& file) { return file.has_parent_path() ? file.parent_path() : "."; }

OutputFolder::OutputFolder(const fs::path& path) : path_(path) {
    std::error_code failed;
    was_there_ = fs::exists(path, failed);
    prepare_folder(path);
}

OutputFolder::~OutputFolder() {
    std::error_code failed;
    // Fails if the folder is not empty; the error is ignored.
    if (!was_there_) fs::remove(path_, failed);
}

void check_scan_folder(const fs::path& folder, bool overwrite) {
    if (const fs::path foreign = find_foreign_file(folder); !foreign.empty())
        fail<UsageError>("--out {}: found {}, which is not listed in a scans.json; expected a new folder",
                         folder.string(), foreign.filename().string());
    const std::vector<fs::path> scans = list_scan_files(folder);
    if (contains_run(folder))
        fail<UsageError>("--out {}: this is a run folder; choose a different folder for scans",
                         folder.string());
    if (const fs::path index = folder / kDatasetIndex; !overwrite && fs::exists(index))
        fail<UsageError>("--out {}: this is a data set ({}); expected --layout, a new folder, or --force",
                         folder.string(), kDatasetIndex);
    // Rendered scans can also be read as a log.
    if (scans.empty() && is_dataset(folder))
        fail<UsageError>("--out {}: this is a log; choose a different folder for scans", folder.string());
    if (!scans.empty() && !overwrite)
        fail<UsageError>(
            "--out {}: the folder contains scans ({} files, for example {}); expected a new folder, or "
            "--force",
            folder.string(), scans.size(), scans.front().filename().string());
}

LockedFolder::LockedFolder(const fs::path& path) : folder_(reject_home(path)), lock_(path) {}

FolderLock::FolderLock(fs::path file, int descriptor) : file_(std::move(file)), descriptor_(descriptor) {}

FolderLock::FolderLock(const fs::path& folder, std::chrono::milliseconds max_wait)
    : file_(folder / kLockFile) {
    const auto end = std::chrono::steady_clock::now() + max_wait;
    std::optional<OpenLockFile> lock = lock_file(file_);
    while (!lock && std::chrono::steady_clock::now() < end) {
        std::this_thread::sleep_for(kLockPollInterval);
        lock = lock_file(file_);
    }
    if (!lock)
        fail("cannot write {}: another relidar process is writing this {}", folder.string(),
             contains_run(folder) ? "run" : "folder");
    descriptor_ = lock->descriptor;
    // If the file system has no locks, temporary files may belong to a running process.
    if (lock->exclusive) remove_temporary(folder);
}

std::unique_ptr<FolderLock> FolderLock::try_lock_folder(const fs::path& folder) {
    const fs::path file = folder / kLockFile;
    const std::optional<OpenLockFile> lock = lock_file(file);
    if (!lock) return nullptr;
    if (lock->exclusive) remove_temporary(folder);
    return std::unique_ptr<FolderLock>(new FolderLock(file, lock->descriptor));
}

bool FolderLock::is_locked(const fs::path& folder) {
    const int descriptor = ::open((folder / kLockFile).c_str(), O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) return false;
    const bool held = ::flock(descriptor, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    ::close(descriptor);
    return held;
}

FolderLock::~FolderLock() {
    // Otherwise another process could lock the file just before it is removed.
    if (is_still_at(descriptor_, file_)) ::unlink(file_.c_str());
    ::close(descriptor_);
}

RunOutputFolder::RunOutputFolder(const fs::path& path, ExistingRunPolicy policy)
    : was_empty_(is_free_folder(path)) {
    // Checks the content first, because the lock writes a file into the folder.
    if (!contains_run(path)) check_folder(path, policy);
    folder_.emplace(path);
    lock_.emplace(path, policy == ExistingRunPolicy::keep ? kEndOfOthers : std::chrono::milliseconds{});
    check_folder(path, policy);
}

RunOutputFolder::~RunOutputFolder() {
    if (!was_empty_ || is_interrupted()) return;
    std::error_code failed;
    std::vector<fs::path> unfinished;  // settings and logs of the run and of its blocks
    for (fs::recursive_directory_iterator entry(path(), failed), end; !failed && entry != end;
         entry.increment(failed)) {
        // Removes nothing if there is any other file, because it may be a result.
        const std::string name = entry->path().filename().string();
        if (name == "config.toml" || name == "log.jsonl") unfinished.push_back(entry->path());
        else if (!entry->is_directory(failed) && !is_leftover(entry->path())) return;
    }
    for (const fs::path& file : unfinished) fs::remove(file, failed);
    remove_blocks(path());
    fs::remove(checkpoint_folder(path()), failed);
}

namespace {

/// Returns false if the folder has files that do not belong to a run.
bool has_only_run_files(const fs::path& folder) {
    static const std::vector<std::string> kRunFileNames = split_text(
        "config.toml,scene.json,model.safetensors,drop_network.safetensors,blocks,checkpoints,log.jsonl,"
        "sweeps.safetensors,metrics.json,report.html,views.png,coverage.safetensors,classes.safetensors,"
        "asset.json,intensity_scatter.safetensors",
        ',');
    for (const auto& entry : fs::directory_iterator(folder))
        if (!is_leftover(entry.path()) &&
            std::ranges::count(kRunFileNames, entry.path().filename().string()) == 0)
            return false;
    return true;
}

}  // namespace

RunFolderWriter::RunFolderWriter(const fs::path& path, bool replace_existing) : path_(path) {
    std::error_code failed;
    if (fs::exists(path, failed))
        earlier_.emplace(path, replace_existing ? ExistingRunPolicy::replace : ExistingRunPolicy::refuse);
}

/// Saves a run to the folder. Exchanges a folder with an earlier run in one step. If the
/// folder has other files, or cannot be renamed, replaces only the files of the run.
void RunFolderWriter::save_run_in(Run& run) const {
    run.folder = path_;
    if (!earlier_) return save_run(run);
    if (has_only_run_files(path_)) {
        bool is_replaced = true;
        run.folder = fs::canonical(path_);  // If the path is a link, keeps the link.
        try {
            replace_run(run);
        } catch (const DataError&) {
            is_replaced = false;  // The folder is a mount point or its parent is read-only.
        }
        run.folder = path_;
        if (is_replaced) return;
    }
    overwrite_run(run, [&] {
        remove_results(path_);
        remove_blocks(path_);
        std::error_code failed;
        fs::remove_all(checkpoint_folder(path_), failed);  // A later training would continue from them.
    });
}

bool contains_run(const fs::path& folder) {
    if (is_run_folder(folder) || !list_checkpoints(checkpoint_folder(folder)).empty()) return true;
    const std::string header_line = to_toml({}).substr(0, to_toml({}).find('\n'));
    std::string line;
    std::ifstream config(folder / "config.toml");
    return std::getline(config, line) && line == header_line;
}

void remove_results(const fs::path& folder) {
    std::error_code failed;
    for (const char* name : {"scene.json", "model.safetensors", "log.jsonl", "metrics.json", "report.html"})
        fs::remove(folder / name, failed);
}

void remove_blocks(const fs::path& run_folder) {
    std::error_code failed;
    fs::remove_all(blocks_folder(run_folder), failed);
}

fs::path blocks_folder(const fs::path& run_folder) { return run_folder / "blocks"; }

fs::path checkpoint_folder(const fs::path& run_folder) { return run_folder / "checkpoints"; }

fs::path network_checkpoint_folder(const fs::path& run_folder) {
    return checkpoint_folder(run_folder) / kRefineCheckpoints;
}

void remove_network_state(const fs::path& run_folder) {
    remove_checkpoints(network_checkpoint_folder(run_folder));
    std::error_code failed;
    // Fails if the folder still contains checkpoints of the scene; the error is ignored.
    fs::remove(checkpoint_folder(run_folder), failed);
}

}  // namespace relidar::cli
