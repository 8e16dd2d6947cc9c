// SPDX-License-Identifier: Apache-2.0
// Writes files atomically. Writes to a temporary file in the same folder, flushes it,
// renames it and flushes the folder. After a power failure, the path contains either the
// complete old file or the complete new file. Folders get a temporary name until they are
// complete.
#include <relidar/base/files.hpp>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cerrno>
#include <csignal>
#include <regex>

#include <fcntl.h>
#include <stdio.h>
#include <sys/file.h>
#include <unistd.h>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "base/number_text.hpp"
#include "file_io.hpp"

namespace relidar {

namespace codecs {

std::string metadata_line(const std::pair<std::string, std::string>& key_and_value) {
    std::string line = key_and_value.first + " " + key_and_value.second;
    std::replace_if(
        line.begin(), line.end(), [](unsigned char character) { return std::iscntrl(character) != 0; }, ' ');
    return line;
}

std::string errno_text(int error_number) { return std::generic_category().message(error_number); }

OutputFile::OutputFile(const std::filesystem::path& path) : file_(std::fopen(path.c_str(), "wb")) {
    if (!file_) throw DataError("cannot create a temporary file in the same folder: " + errno_text(errno));
}

OutputFile::~OutputFile() {
    if (file_) std::fclose(file_);
}

void OutputFile::write(const void* data, std::size_t n_bytes) {
    if (n_bytes > 0 && std::fwrite(data, 1, n_bytes, file_) != n_bytes)
        fail("cannot write {} bytes: {}", n_bytes, errno_text(errno));
}

void OutputFile::close() {
    const bool flushed = std::fflush(file_) == 0;
    const int flush_error = errno;
    const bool closed = std::fclose(std::exchange(file_, nullptr)) == 0;
    if (!flushed || !closed)
        throw DataError("cannot write the last bytes: " + errno_text(flushed ? errno : flush_error));
}

}  // namespace codecs

namespace {

namespace fs = std::filesystem;
using codecs::errno_text;

[[noreturn]] void fail_write(const fs::path& path, std::string why) {
    // Messages of libraries may have several lines.
    std::replace(why.begin(), why.end(), '\n', ' ');
    fail("cannot write '{}': {}", path.string(), why);
}

struct TemporaryFile {
    fs::path path;
    bool renamed = false;

    ~TemporaryFile() {
        if (!renamed) ::unlink(path.c_str());
    }
};

/// Returns the path of the file to write. Follows a symbolic link, so that writing does
/// not replace the link. Rejects devices and other targets that are not regular files.
fs::path resolve_target(const fs::path& path) {
    if (!path.has_filename()) fail_write(path, "the path has no file name");
    std::error_code error;
    const fs::file_status status = fs::status(path, error);
    if (fs::exists(status)) {
        if (!fs::is_regular_file(status))
            fail_write(path, "something that is not a regular file already has this name");
        return fs::canonical(path);
    }
    const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
    const fs::file_status parent = fs::status(folder, error);
    if (!fs::exists(parent))
        fail_write(path, fmt::format("folder '{}': {}", folder.string(),
                                     errno_text(error ? error.value() : ENOENT)));
    if (!fs::is_directory(parent)) fail_write(path, fmt::format("'{}' is not a folder", folder.string()));
    return folder / path.filename();
}

/// Calls `write_content` with the temporary path. Adds the path of the file to errors
/// that concern the file: data errors and exceptions of libraries. Passes on all others,
/// for example a failure of the GPU during a download.
/// @param shown_path  path of the file as the user wrote it
void write_temp(const fs::path& shown_path, const fs::path& temporary,
                const std::function<void(const fs::path&)>& write_content) {
    try {
        write_content(temporary);
    } catch (const Error& error) {
        if (error.code() != ExitCode::data) throw;
        fail_write(shown_path, error.what());
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& error) {
        fail_write(shown_path, error.what());
    }
}

void flush_file(const fs::path& where, const fs::path& temporary) {
    const int file = ::open(temporary.c_str(), O_RDONLY | O_CLOEXEC);
    if (file < 0) fail_write(where, "cannot reopen the written file: " + errno_text(errno));
    const int result = ::fsync(file), error = errno;
    ::close(file);
    if (result != 0) fail_write(where, "cannot flush the file to disk: " + errno_text(error));
}

/// Flushes the folder, so that the new file name survives a power failure. Ignores
/// folders that cannot be opened and file systems that cannot flush folders.
void flush_folder(const fs::path& file_path) {
    const int folder = ::open(file_path.parent_path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (folder < 0) return;
    const int result = ::fsync(folder), error = errno;
    ::close(folder);
    if (result != 0 && error != EINVAL && error != ENOTSUP && error != EROFS)
        fail_write(file_path, "cannot flush its folder to disk: " + errno_text(error));
}

// File in each temporary folder. Its process locks it. Other programs have no such file.
constexpr const char* kMarkerFile = ".relidar_staged";
constexpr std::string_view kStagedInfix = ".tmp-";

/// Returns the process id in the name .NAME.tmp-PID, or 0 for another name.
pid_t parse_process_id(const std::string& folder_name) {
    const std::size_t infix = folder_name.rfind(kStagedInfix);
    if (!folder_name.starts_with('.') || infix == std::string::npos) return 0;
    return parse_integer<pid_t>(folder_name.substr(infix + kStagedInfix.size())).value_or(0);
}

/// True for a temporary folder (.NAME.tmp-PID) whose process no longer exists. A process
/// on another machine may have the same folder, so its lock counts, too.
/// @param own_prefix ".NAME.tmp-"; such folders are abandoned even without a marker
bool is_abandoned(const fs::path& path, const std::string& own_prefix) {
    const std::string name = path.filename().string();
    const pid_t process = parse_process_id(name);
    if (process <= 0) return false;
    // Signal 0 sends nothing. The error ESRCH means that the process does not exist.
    const bool has_ended = ::kill(process, 0) != 0 && errno == ESRCH;
    if (!has_ended) return false;
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

fs::path make_temp_path(const fs::path& final_path) {
    // Makes temporary names unique, because two threads may write the same file.
    static std::atomic<unsigned> count{0};
    return final_path.parent_path() /
           fmt::format(".{}.tmp-{}-{}", final_path.filename().string(), ::getpid(), count++);
}

void write_atomically(const fs::path& path, const std::function<void(const fs::path&)>& write) {
    const fs::path target = resolve_target(path);
    TemporaryFile temporary{make_temp_path(target)};
    write_temp(path, temporary.path, write);
    flush_file(path, temporary.path);
    if (::rename(temporary.path.c_str(), target.c_str()) != 0)
        fail_write(path, "cannot rename the temporary file: " + errno_text(errno));
    temporary.renamed = true;
    flush_folder(target);
}

void remove_temp(const fs::path& folder) {
    static const std::regex kTempName(R"(\..+\.tmp-[0-9]+-[0-9]+)");
    std::error_code failed;
    // Collects the paths first, because the loop must not change the folder.
    std::vector<fs::path> temporary_paths;
    for (const auto& entry : fs::directory_iterator(folder, failed)) {
        // relidar creates only files and folders, so a link belongs to somebody else.
        const bool is_file_or_folder =
            entry.is_regular_file(failed) || (entry.is_directory(failed) && !entry.is_symlink(failed));
        if (is_file_or_folder && std::regex_match(entry.path().filename().string(), kTempName))
            temporary_paths.push_back(entry.path());
    }
    for (const fs::path& path : temporary_paths) fs::remove_all(path, failed);
}

void write_text_file(const fs::path& path, const std::string& text) { codecs::write_file(path, text); }

void codecs::write_file(const std::filesystem::path& path, std::string_view bytes) {
    write_atomically(path, [&](const std::filesystem::path& temporary) {
        OutputFile file(temporary);
        file.write(bytes);
        file.close();
    });
}

/// Creates the temporary folder .NAME.tmp-PID next to the final one, so that it can be
/// renamed. Also removes such folders of processes that were killed.
StagedFolder::StagedFolder(const fs::path& final_path)
    // Removes a slash at the end, because filename() would be empty.
    : final_path_((fs::absolute(final_path) / "").lexically_normal().parent_path()) {
    const std::string prefix = fmt::format(".{}{}", final_path_.filename().string(), kStagedInfix);
    remove_abandoned(final_path_.parent_path(), prefix);
    path_ = final_path_.parent_path() / fmt::format("{}{}", prefix, ::getpid());
    std::error_code failed;
    fs::remove_all(path_, failed);
    fs::create_directories(path_, failed);
    if (failed) fail("cannot create the folder {}: {}", path_.string(), failed.message());
    // The lock shows other machines, which do not know the process, that the folder is in
    // use. A file system without locks is no error.
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
    // rename() replaces an empty folder. It fails if anything else exists there.
    if (::rename(path_.c_str(), final_path_.c_str()) == 0) return;
    const int error = errno;
    const bool destination_exists = error == ENOTEMPTY || error == EEXIST || error == ENOTDIR;
    fail("cannot create {}: {}", final_path_.string(),
         destination_exists ? "another process has created it in the meantime"
                            : "renaming the temporary folder failed: " + errno_text(error));
}

void StagedFolder::replace_folder() const {
    ::unlink((path_ / kMarkerFile).c_str());
#ifdef RENAME_EXCHANGE
    // Exchanges the new and the old folder atomically. The old folder then has the
    // temporary name, and the destructor deletes it.
    if (::renameat2(AT_FDCWD, path_.c_str(), AT_FDCWD, final_path_.c_str(), RENAME_EXCHANGE) == 0) return;
#endif
    // Without such an exchange: moves the old folder away, and back if the new one fails.
    const fs::path old = path_.string() + "-old";
    std::error_code failed, ignored;
    if (fs::exists(fs::symlink_status(final_path_, ignored))) fs::rename(final_path_, old, failed);
    if (!failed) fs::rename(path_, final_path_, failed);
    if (failed) {
        fs::rename(old, final_path_, ignored);
        fail("cannot create {}: renaming the temporary folder failed: {}", final_path_.string(),
             failed.message());
    }
    fs::remove_all(old, ignored);
}

}  // namespace relidar
