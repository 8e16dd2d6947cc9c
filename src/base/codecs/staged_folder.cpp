// SPDX-License-Identifier: Apache-2.0
// Creates folders atomically. Files are written to a temporary folder next to the final
// folder. When the temporary folder is complete, it is renamed.
#include <relidar/base/files.hpp>

#include <cerrno>
#include <charconv>
#include <csignal>

#include <fcntl.h>
#include <stdio.h>
#include <unistd.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

namespace fs = std::filesystem;

/// Removes temporary folders of processes that no longer exist. The name of a temporary
/// folder consists of the prefix and a process id.
void remove_folders_of_dead_processes(const fs::path& parent_folder, const std::string& name_prefix) {
    std::error_code failed;
    std::vector<fs::path> abandoned;
    for (const auto& entry : fs::directory_iterator(parent_folder, failed)) {
        const std::string name = entry.path().filename().string();
        if (!name.starts_with(name_prefix)) continue;
        pid_t process = 0;
        const auto [end, error] =
            std::from_chars(name.data() + name_prefix.size(), name.data() + name.size(), process);
        if (error == std::errc() && end == name.data() + name.size() && process > 0 &&
            ::kill(process, 0) != 0 && errno == ESRCH)
            abandoned.push_back(entry.path());
    }
    for (const fs::path& path : abandoned) fs::remove_all(path, failed);
}

}  // namespace

StagedFolder::StagedFolder(const fs::path& final_path)
    : final_path_((fs::absolute(final_path) / "").lexically_normal().parent_path()) {
    const std::string prefix = fmt::format(".{}.tmp-", final_path_.filename().string());
    remove_folders_of_dead_processes(final_path_.parent_path(), prefix);
    path_ = final_path_.parent_path() / fmt::format("{}{}", prefix, ::getpid());
    std::error_code failed;
    fs::remove_all(path_, failed);
    fs::create_directories(path_, failed);
    if (failed)
        throw DataError(fmt::format("cannot create the folder {}: {}", path_.string(), failed.message()));
}

StagedFolder::~StagedFolder() {
    std::error_code failed;
    fs::remove_all(path_, failed);
}

void StagedFolder::move_folder_without_replacing_existing() const {
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

void StagedFolder::move_folder_and_replace_existing() const {
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
        throw DataError(fmt::format("cannot create {}: renaming the temporary folder failed: {}",
                                    final_path_.string(), failed.message()));
    fs::remove_all(old, ignored);
}

}  // namespace relidar
