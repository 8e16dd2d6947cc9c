// SPDX-License-Identifier: Apache-2.0
// Writes files and folders atomically. The final name exists only when the content is
// complete.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace relidar {

/// Writes a file atomically. Calls `write` with a temporary path in the same
/// folder, flushes the temporary file to disk and renames it. The folder must exist. If
/// `path` is a symbolic link, the target of the link is written. A target that is not a
/// regular file (a folder, /dev/null) is rejected.
/// @throws DataError if the folder cannot be written or the disk is full. The temporary
/// file is then removed. A DataError or standard exception from `write` is rethrown as a
/// DataError that names the path. Other relidar errors are passed on unchanged.
void write_atomically(const std::filesystem::path& path,
                      const std::function<void(const std::filesystem::path&)>& write);
/// Returns a unique temporary path in the same folder as `final_path`. The caller writes
/// the file there and then renames it to `final_path`. remove_temp() removes
/// temporary files that were never renamed.
std::filesystem::path make_temp_path(const std::filesystem::path& final_path);
/// Removes temporary files and folders that a killed process has left in a folder. These
/// files have names of the form .NAME.tmp-PID-COUNT. Call this function only for a folder
/// to which no other process writes.
void remove_temp(const std::filesystem::path& folder);
/// Writes a text file atomically. The final name exists only when the content is
/// complete.
void write_text_file(const std::filesystem::path& path, const std::string& text);

/// Returns the last part of a path, also of a folder that ends in "/". Files that users
/// share have this name instead of the path.
std::string file_name_of(const std::filesystem::path& path);

/// Temporary folder that gets its final name when it is complete.
/// replace_folder() renames the temporary folder and replaces an
/// existing folder with the final name. If replace_folder() is not
/// called, the destructor removes the temporary folder. The constructor also removes
/// temporary folders that killed processes have left next to the final folder.
class StagedFolder {
public:
    /// Creates the temporary folder.
    /// @throws DataError if the folder cannot be created
    explicit StagedFolder(const std::filesystem::path& final_path);
    ~StagedFolder();
    StagedFolder(const StagedFolder&) = delete;
    StagedFolder& operator=(const StagedFolder&) = delete;

    /// Path of the temporary folder. Write files to this path before replace_folder().
    const std::filesystem::path& path() const { return path_; }
    /// Renames the temporary folder to its final name and replaces an existing folder.
    /// @throws DataError if the folder cannot be renamed. An existing folder is then
    /// kept.
    void replace_folder() const;
    /// Renames the temporary folder to its final name. If a folder with this name exists,
    /// it is replaced only if it is empty.
    /// @throws DataError if the name is in use, or the folder cannot be renamed
    void publish_folder() const;

private:
    std::filesystem::path final_path_, path_;
    int marker_ = -1;  ///< file descriptor of a locked file in the temporary folder
};

/// Metadata of a file, as pairs of name and value.
using FileMetadata = std::vector<std::pair<std::string, std::string>>;

}  // namespace relidar
