// SPDX-License-Identifier: Apache-2.0
// Writes files atomically. Writes to a temporary file in the same folder, flushes it,
// renames it and flushes the folder. After a power failure, the path contains either the
// complete old file or the complete new file.
#include <relidar/base/files.hpp>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <regex>

#include <fcntl.h>
#include <unistd.h>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "file_io.hpp"

namespace relidar {
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

/// Calls the writer. Only data errors get the path of the file. For example, a GPU
/// failure during a download is not a file error.
void write_temp(const fs::path& where, const fs::path& temporary,
                const std::function<void(const fs::path&)>& write_content) {
    try {
        write_content(temporary);
    } catch (const Error& error) {
        // For example, a GPU failure during a download is not a file error.
        if (error.code() != ExitCode::data) throw;
        fail_write(where, error.what());
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& error) {
        fail_write(where, error.what());
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
    static const std::regex kTemporaryInfix(R"(\..+\.tmp-[0-9]+-[0-9]+)");
    std::error_code failed;
    // Collects the paths first, because the loop must not change the folder.
    std::vector<fs::path> temporary_paths;
    for (const auto& entry : fs::directory_iterator(folder, failed)) {
        const bool is_ours =
            entry.is_regular_file(failed) || (entry.is_directory(failed) && !entry.is_symlink(failed));
        if (is_ours && std::regex_match(entry.path().filename().string(), kTemporaryInfix))
            temporary_paths.push_back(entry.path());
    }
    for (const fs::path& path : temporary_paths) fs::remove_all(path, failed);
}

void write_text_file(const fs::path& path, const std::string& text) { codecs::write_file(path, text); }

}  // namespace relidar
