// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/files.hpp>

#include <cerrno>
#include <charconv>
#include <csignal>
#include <string_view>

#include <fcntl.h>
#include <stdio.h>
#include <sys/file.h>
#include <unistd.h>

#include <fmt/format.h>

#include "base/fail.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

// File in each temporary folder. Its process locks it. Other programs have no such file.
constexpr const char* kMarkerFile = ".relidar_staged";
constexpr std::string_view kTemporaryInfix = ".tmp-";

/// True for a temporary folder (.NAME.tmp-PID) whose process no longer exists. A process
/// on another machine may have the same folder, so its lock counts, too.
/// @param own_prefix ".NAME.tmp-"; such folders are abandoned even without a marker
bool is_abandoned(const fs::path& path, const std::string& own_prefix) {
    const std::string name = path.filename().string();
    const std::size_t at = name.rfind(kTemporaryInfix);
    if (!name.starts_with('.') || at == std::string::npos) return false;
    pid_t process = 0;
    const char* last = name.data() + name.size();
    const auto [end, error] = std::from_chars(name.data() + at + kTemporaryInfix.size(), last, process);
    if (error != std::errc() || end != last || process <= 0) return false;
    if (::kill(process, 0) == 0 || errno != ESRCH) return false;
    const int marker = ::open((path / kMarkerFile).c_str(), O_RDWR | O_CLOEXEC);
    if (marker < 0) return errno == ENOENT && name.starts_with(own_prefix);
    const bool is_unlocked = ::flock(marker, LOCK_EX | LOCK_NB) == 0;
    ::close(marker);
    return is_unlocked;
}

void remove_abandoned(const fs::path& parent_folder, const std::string& own_prefix) {
    std::error_code failed;
    std::vector<fs::path> abandoned;
    for (const auto& entry : fs::directory_iterator(parent_folder, failed))
        if (is_abandoned(entry.path(), own_prefix)) abandoned.push_back(entry.path());
    for (const fs::path& path : abandoned) fs::remove_all(path, failed);
}

}  // namespace

StagedFolder::StagedFolder(const fs::path& final_path)
    // Removes a slash at the end, because filename() would be empty.
    : final_path_((fs::absolute(final_path) / "").lexically_normal().parent_path()) {
    const std::string prefix = fmt::format(".{}{}", final_path_.filename().string(), kTemporaryInfix);
    remove_abandoned(final_path_.parent_path(), prefix);
    path_ = final_path_.parent_path() / fmt::format("{}{}", prefix, ::getpid());
    std::error_code failed;
    fs::remove_all(path_, failed);
    fs::create_directories(path_, failed);
    if (failed) fail("cannot create the folder {}: {}", path_.string(), failed.message());
    // While this process holds the lock, remove_abandoned() keeps the folder, even on
    // another machine.
    marker_ = ::open((path_ / kMarkerFile).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (marker_ >= 0) (void)::flock(marker_, LOCK_EX | LOCK_NB);
}

StagedFolder::~StagedFolder() {
    std::error_code failed;
    fs::remove_all(path_, failed);
    if (marker_ >= 0) ::close(marker_);
}

void StagedFolder::publish_folder() const {
    ::unlink((path_ / kMarkerFile).c_str());
    // rename() replaces an empty folder. It fails if anything else exists at the
    // destination.
    if (::rename(path_.c_str(), final_path_.c_str()) == 0) return;
    const int error = errno;
    const bool destination_exists = error == ENOTEMPTY || error == EEXIST || error == ENOTDIR;
    throw DataError(destination_exists
                        ? fmt::format("cannot create {}: another process has created it in the meantime",
                                      final_path_.string())
                        : fmt::format("cannot create {}: renaming the temporary folder failed: {}",
                                      final_path_.string(), std::generic_category().message(error)));
}

void StagedFolder::replace_folder() const {
    ::unlink((path_ / kMarkerFile).c_str());
#ifdef RENAME_EXCHANGE
    // Exchanges the new and the old folder atomically. The old folder then has the
    // temporary name, and the destructor deletes it.
    if (::renameat2(AT_FDCWD, path_.c_str(), AT_FDCWD, final_path_.c_str(), RENAME_EXCHANGE) == 0) return;
#endif
    const fs::path old = path_.string() + "-old";
    std::error_code failed, ignored;
    if (fs::exists(fs::symlink_status(final_path_, ignored))) fs::rename(final_path_, old, failed);
    if (!failed) fs::rename(path_, final_path_, failed);
    if (failed) fs::rename(old, final_path_, ignored);
    if (failed)
        fail("cannot create {}: renaming the temporary folder failed: {}", final_path_.string(),
             failed.message());
    fs::remove_all(old, ignored);
}

}  // namespace relidar
