// SPDX-License-Identifier: Apache-2.0
// The files of a log, some of which an input replaces, so that each reader is reached
// whatever another one would have said before. Input: options, then sections of file
// number, length (2 bytes, little-endian), bytes; the last may be cut.
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
    /// Inputs with the options alone, and with each file by itself: the start of a scan,
    /// all of a text.
    std::vector<std::string> seeds(const std::vector<unsigned>& alone,
                                   const std::vector<unsigned>& with_a_file) const;

    /// The simpler form: the first byte of an input chooses the one file that the rest
    /// replaces; an empty one changes and reads nothing.
    void read_one(std::string_view input, const std::function<void()>& read) const;
    /// Inputs of that form: each file as it is.
    std::vector<std::string> seeds_of_one() const;

private:
    std::vector<std::filesystem::path> files_;
    std::vector<std::string> usual_;
};

}  // namespace relidar::fuzz
