// SPDX-License-Identifier: Apache-2.0
// Replaces some files of a log with parts of a fuzz input, so that each reader is reached
// independently of errors of other readers. The input has options, then sections of file
// number, length (2 bytes, little-endian) and bytes. The last section may be truncated.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::fuzz {

class ChangedFiles {
public:
    /// @param files files with their original content
    explicit ChangedFiles(std::vector<std::filesystem::path> files);

    /// Writes the files that an input contains, reads the log, and restores the files.
    void read(std::string_view input, const std::function<void(unsigned options)>& read) const;
    /// Returns inputs with options only, and inputs with each single file: the start of a
    /// scan, or the complete text.
    std::vector<std::string> seeds(const std::vector<unsigned>& alone,
                                   const std::vector<unsigned>& with_a_file) const;

    /// Reads the simple input format: the first byte selects the file that the rest
    /// replaces. An empty input does nothing.
    void read_one(std::string_view input, const std::function<void()>& read) const;
    /// Returns inputs in the simple format: each file unchanged.
    std::vector<std::string> seeds_of_one() const;

private:
    std::vector<std::filesystem::path> files_;
    std::vector<std::string> usual_;
};

}  // namespace relidar::fuzz
