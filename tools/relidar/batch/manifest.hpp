// SPDX-License-Identifier: Apache-2.0
// The manifest of `relidar batch`: a TOML file with [defaults] and [[job]] entries becomes one job a log. Knows nothing of what is on disk
// but the names that patterns match.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace relidar::cli {

/// One log, what of it is read, and what is made of it. Texts and paths are as the manifest has them: relative to its folder.
struct BatchJob {
    std::string name;                              ///< of its folder: letters, digits, "_", "-", "."
    std::string log;                               ///< a path, or kind:path
    std::string sequence, frames, preset, config;  ///< as the options of `relidar train`; empty: not given
    std::map<std::string, std::string> settings;   ///< setting to value
    std::string out;                               ///< run folder, with {name}; empty: where the batch puts it
    std::vector<std::string> steps;                ///< command lines to run after training, with {run}, {job}, {name}
    std::string where;                             ///< "manifest.toml:12: job drive5", for messages
};

struct BatchManifest {
    std::filesystem::path file;
    std::vector<BatchJob> jobs;

    /// What paths in it are relative to; absolute.
    std::filesystem::path folder() const { return std::filesystem::absolute(file).parent_path(); }
};

/// @throws DataError where it cannot be read or is not TOML, UsageError for an unknown key (the nearest is named), a value of the wrong
/// kind, a pattern that nothing matches, a name that cannot be a folder's
BatchManifest load_manifest(const std::filesystem::path& file);

/// The same of a text. @param folder where patterns are looked up
std::vector<BatchJob> parse_manifest(const std::string& text, const std::string& file, const std::filesystem::path& folder);

}  // namespace relidar::cli
