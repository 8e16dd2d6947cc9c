// SPDX-License-Identifier: Apache-2.0
// The files of a log, some of which an input replaces, so that each reader is reached whatever another one would have said before. Input:
// options, then sections of file number, length (2 bytes, little-endian), bytes; the last may be cut.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::fuzz {

class ChangedFiles {
public:
    /// @param files  as they are written now
    explicit ChangedFiles(std::vector<std::filesystem::path> files);

    /// Writes what an input says, reads, and puts back what was there.
    void read(std::string_view input, const std::function<void(unsigned options)>& read) const;
    /// Inputs with the options alone, and with each file by itself: the start of a scan, all of a text.
    std::vector<std::string> seeds(const std::vector<unsigned>& alone, const std::vector<unsigned>& with_a_file) const;

private:
    std::vector<std::filesystem::path> files_;
    std::vector<std::string> usual_;
};

}  // namespace relidar::fuzz
