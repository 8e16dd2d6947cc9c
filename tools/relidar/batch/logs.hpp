// SPDX-License-Identifier: Apache-2.0
// Which logs the texts of a manifest stand for, and what their jobs are called.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace relidar::cli {

/// A log and the name that its path gives it: from the first part with a wildcard on, else the last part. Other logs do not change it, so
/// that a longer list finds its folders again.
struct NamedLog {
    std::string log;   ///< a path, or kind:path
    std::string name;
};

/// The logs that a text stands for; "kind:" in front stays with each. A text that is no pattern stands for itself, whether it is there or
/// not. @param folder what patterns are relative to @throws UsageError for a pattern that nothing matches
std::vector<NamedLog> find_logs(const std::string& text, bool may_be_pattern, const std::filesystem::path& folder);

/// Letters, digits, "_", "-" and "." stay, others become "_": a folder's name on any file system, and one word for a shell.
std::string as_name(std::string text);

}  // namespace relidar::cli
