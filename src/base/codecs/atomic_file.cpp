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

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "file_io.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using codecs::get_system_error_message;

[[noreturn]] void throw_write_error(const fs::path& path, std::string why) {
    // Messages of libraries may have several lines.
    std::replace(why.begin(), why.end(), '\n', ' ');
    fail("cannot write '{}': {}", path.string(), why);
}

/// Removes the temporary file at the end of the scope, if it was not renamed.
struct TemporaryFile {
    fs::path path;
    bool renamed = false;

    ~TemporaryFile() {
        if (!renamed) ::unlink(path.c_str());
    }
};

/// Follows a symbolic link, so that writing does not replace the link.
fs::path follow_link_and_require_regular_file(const fs::path& path) {
    if (!path.has_filename()) throw_write_error(path, "the path has no file name");
    std::error_code error;
    const fs::file_status status = fs::status(path, error);
    if (fs::exists(status)) {
        if (!fs::is_regular_file(status))
            throw_write_error(path, "something that is not a regular file already has this name");
        return fs::canonical(path);
    }
    const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
    const fs::file_status parent = fs::status(folder, error);
    if (!fs::exists(parent))
        throw_write_error(path, fmt::format("folder '{}': {}", folder.string(),
                                            get_system_error_message(error ? error.value() : ENOENT)));
    if (!fs::is_directory(parent))
        throw_write_error(path, fmt::format("'{}' is not a folder", folder.string()));
    return folder / path.filename();
}

void write_temporary_file(const fs::path& path_for_errors, const fs::path& temporary_path,
                          const std::function<void(const fs::path&)>& write_content) {
    try {
        write_content(temporary_path);
    } catch (const Error& error) {
        // For example, a GPU failure during a download is not a file error.
        if (error.code() != ExitCode::data) throw;
        throw_write_error(path_for_errors, error.what());
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& error) {
        throw_write_error(path_for_errors, error.what());
    }
}

void flush_file_to_disk(const fs::path& path_for_errors, const fs::path& temporary_path) {
    const int file = ::open(temporary_path.c_str(), O_RDONLY | O_CLOEXEC);
    if (file < 0)
        throw_write_error(path_for_errors,
                          "cannot reopen the written file: " + get_system_error_message(errno));
    const int result = ::fsync(file), error = errno;
    ::close(file);
    if (result != 0)
        throw_write_error(path_for_errors,
                          "cannot flush the file to disk: " + get_system_error_message(error));
}

/// The new file name then survives a power failure. Ignores failures, because some file
/// systems cannot flush folders.
void flush_parent_folder_to_disk(const fs::path& file_path) {
    const int folder = ::open(file_path.parent_path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (folder < 0) return;
    const int result = ::fsync(folder), error = errno;
    ::close(folder);
    if (result != 0 && error != EINVAL && error != ENOTSUP && error != EROFS)
        throw_write_error(file_path, "cannot flush its folder to disk: " + get_system_error_message(error));
}

}  // namespace

fs::path make_unique_temporary_path(const fs::path& final_path) {
    // Makes temporary names unique, because two threads may write the same file.
    static std::atomic<unsigned> count{0};
    return final_path.parent_path() /
           fmt::format(".{}.tmp-{}-{}", final_path.filename().string(), ::getpid(), count++);
}

void write_file_atomically(const fs::path& path, const std::function<void(const fs::path&)>& write_content) {
    const fs::path target = follow_link_and_require_regular_file(path);
    TemporaryFile temporary{make_unique_temporary_path(target)};
    write_temporary_file(path, temporary.path, write_content);
    flush_file_to_disk(path, temporary.path);
    if (::rename(temporary.path.c_str(), target.c_str()) != 0)
        throw_write_error(path, "cannot rename the temporary file: " + get_system_error_message(errno));
    temporary.renamed = true;
    flush_parent_folder_to_disk(target);
}

void remove_temporary_files(const fs::path& folder) {
    static const std::regex kTemporary(R"(\..+\.tmp-[0-9]+-[0-9]+)");
    std::error_code failed;
    std::vector<fs::path> temporary_paths;
    for (const auto& entry : fs::directory_iterator(folder, failed)) {
        const bool is_ours =
            entry.is_regular_file(failed) || (entry.is_directory(failed) && !entry.is_symlink(failed));
        if (is_ours && std::regex_match(entry.path().filename().string(), kTemporary))
            temporary_paths.push_back(entry.path());
    }
    for (const fs::path& path : temporary_paths) fs::remove_all(path, failed);
}

void write_text_file(const fs::path& path, const std::string& text) { codecs::write_file(path, text); }

}  // namespace relidar
