// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <relidar/run/edit.hpp>

namespace relidar::cli {

struct EditArgument {
    std::string option;  ///< For example "--move".
    std::string value;   ///< For example "0:0,3.5,0".
};

struct EditResult {
    SceneWithLog driving;
    std::string description;  ///< One line that describes the edit.
    std::string note;         ///< Warning for the user. Empty if the edit causes no warning.
};

struct EditOption {
    std::string_view option;
    EditResult (*apply)(SceneWithLog edited, const EditArgument& edit);
    const char* form;  ///< Syntax of the value, for the help and for errors.
    const char* help;
};
/// The table of all edits. To add an edit, add its function and its row.
const std::vector<EditOption>& edit_options();

/// Applies one edit of the command line.
/// @throws UsageError naming option and value if the value is malformed or the track does
/// not exist
/// @throws DataError if a file is malformed
EditResult apply_edit(SceneWithLog edited, const EditArgument& edit);

}  // namespace relidar::cli
