// SPDX-License-Identifier: Apache-2.0
// Files that appear under their final name only when they are complete.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace relidar {

/// Writes a file by calling `write` on a temporary path beside it, flushing to disk and
/// renaming. The folder must exist. A link is followed; a target that is no regular file
/// (a folder, /dev/null) is refused.
/// @throws DataError where the folder cannot be written or the disk is full; the
/// temporary file is removed. A DataError or standard exception of `write` comes out as a
/// DataError naming the path, other relidar errors as they are.
void write_atomically(const std::filesystem::path& path,
                      const std::function<void(const std::filesystem::path&)>& write);
/// A name beside a file, for what becomes that file once it is complete; never the same
/// twice. remove_temporaries() knows it.
std::filesystem::path temporary_path(const std::filesystem::path& path);
/// Removes what a killed process has left in a folder: files and folders named
/// .NAME.tmp-PID-COUNT. Use it only for a folder that no other process writes to.
void remove_temporaries(const std::filesystem::path& folder);
/// Writes a text through write_atomically.
void write_text(const std::filesystem::path& path, const std::string& text);

/// A folder that is filled beside its name and gets it when it is complete; what has the
/// name goes away then. Where finish() is not reached nothing is left; what a killed
/// process left of the same name is removed by the next one.
class StagedFolder {
public:
    /// @throws DataError where the folder cannot be made
    explicit StagedFolder(const std::filesystem::path& wanted);
    ~StagedFolder();
    StagedFolder(const StagedFolder&) = delete;
    StagedFolder& operator=(const StagedFolder&) = delete;

    const std::filesystem::path& path() const { return path_; }      ///< to write into, until it is finished
    const std::filesystem::path& wanted() const { return wanted_; }  ///< its name, absolute
    /// @throws DataError where it cannot be renamed; what had the name stays
    void finish() const;
    /// The same, unless something has the name by now. An empty folder may have it.
    /// @throws DataError if the name is not free, or the folder cannot be renamed
    void finish_new() const;

private:
    std::filesystem::path wanted_, path_;
};

/// What a file says of itself: names and values, for people and for tools that look for a
/// name.
using FileNotes = std::vector<std::pair<std::string, std::string>>;

}  // namespace relidar
