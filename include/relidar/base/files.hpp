// SPDX-License-Identifier: Apache-2.0
// Functions that write files and folders atomically: the final name exists only once the
// content is complete.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace relidar {

/// Writes a file atomically: calls `write` with a temporary path in the same folder,
/// flushes the file to disk and renames it. The folder must exist. A symbolic link is
/// followed. A target that is not a regular file (a folder, /dev/null) is rejected.
/// @throws DataError if the folder cannot be written or the disk is full; the temporary
/// file is then removed. A DataError or standard exception from `write` is rethrown as a
/// DataError that names the path; other relidar errors are passed on unchanged.
void write_atomically(const std::filesystem::path& path,
                      const std::function<void(const std::filesystem::path&)>& write);
/// Returns a unique temporary path in the folder of `path`. A complete file is then
/// renamed from the temporary path to `path`. remove_temporaries() recognises such names.
std::filesystem::path temporary_path(const std::filesystem::path& path);
/// Removes the temporary files and folders (.NAME.tmp-PID-COUNT) that a killed process
/// left in a folder. Use it only for a folder that no other process writes to.
void remove_temporaries(const std::filesystem::path& folder);
/// Writes a text file with write_atomically().
void write_text(const std::filesystem::path& path, const std::string& text);

/// Temporary folder that is renamed to its final name when it is complete. An existing
/// folder of that name is then removed. If finish() is not called, the destructor removes
/// the temporary folder. The next StagedFolder of the same name removes what a killed
/// process left.
class StagedFolder {
public:
    /// Creates the temporary folder.
    /// @throws DataError if the folder cannot be created
    explicit StagedFolder(const std::filesystem::path& wanted);
    ~StagedFolder();
    StagedFolder(const StagedFolder&) = delete;
    StagedFolder& operator=(const StagedFolder&) = delete;

    /// Path of the temporary folder; write files here before finish().
    const std::filesystem::path& path() const { return path_; }
    /// Absolute path of the final folder.
    const std::filesystem::path& wanted() const { return wanted_; }
    /// Renames the temporary folder to its final name.
    /// @throws DataError if the folder cannot be renamed; an existing folder of that name
    /// is then kept
    void finish() const;
    /// Renames the temporary folder to its final name if that name is free or belongs to
    /// an empty folder.
    /// @throws DataError if the name is not free, or the folder cannot be renamed
    void finish_new() const;

private:
    std::filesystem::path wanted_, path_;
};

/// Metadata of a file as pairs of name and value.
using FileNotes = std::vector<std::pair<std::string, std::string>>;

}  // namespace relidar
