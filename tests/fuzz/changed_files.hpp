// SPDX-License-Identifier: Apache-2.0
// Replaces some files of a log by an input, so that each reader runs even if an earlier
// reader would fail. Format of an input: options, then sections of file number, length (2
// bytes, little-endian) and bytes. The last section may be truncated.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::fuzz {

class ChangedFiles {
public:
    explicit ChangedFiles(std::vector<std::filesystem::path> files);

    void read(std::string_view input, const std::function<void(unsigned options)>& read) const;
    /// Returns inputs with options only, and inputs with the start of a single file.
    std::vector<std::string> seeds(const std::vector<unsigned>& alone,
                                   const std::vector<unsigned>& with_a_file) const;

    /// Reads an input whose first byte selects the file that the remainder replaces.
    void read_one(std::string_view input, const std::function<void()>& read) const;
    std::vector<std::string> make_seeds_of_one() const;

private:
    struct Restore;
    std::vector<std::filesystem::path> files_;
    std::vector<std::string> usual_;
};

/// Returns a small log, which is created in a folder when it is used for the first time.
template <class Dataset>
const Dataset& dataset_in(const std::filesystem::path& folder) {
    ::setenv("TEST_TMPDIR", folder.c_str(), 1);
    static const Dataset dataset;
    return dataset;
}

}  // namespace relidar::fuzz
