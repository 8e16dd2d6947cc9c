// SPDX-License-Identifier: Apache-2.0
// Parses the edit options of the command line, such as "--move 0:0,3.5,0", and applies
// each edit to the scene.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/edit.hpp>

namespace relidar::cli {

/// An option of `relidar edit` with its value.
struct EditArgument {
    std::string option;  ///< For example "--move".
    std::string value;   ///< For example "0:0,3.5,0".
};

/// Describes an option of `relidar edit`: its name, the form of its value, and its help
/// text.
struct EditOption {
    const char* option;
    const char* form;
    const char* help;
};
const std::vector<EditOption>& list_edit_options();

/// Result of applying an edit to a scene.
struct EditResult {
    SceneWithLog driving;
    std::string said;  ///< One line that describes the edit.
    std::string note;  ///< Warning for the user. Empty if the edit causes no warning.
};

/// Applies an edit to a scene and to the tracks of its actors.
/// @throws UsageError if the value is malformed or the track does not exist; the message
/// names the option and the value
/// @throws DataError if a file is malformed
EditResult apply_command_line_edit(SceneWithLog driving_scene, const EditArgument& edit);

}  // namespace relidar::cli
