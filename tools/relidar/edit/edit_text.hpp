// SPDX-License-Identifier: Apache-2.0
// Parses edits on the command line, such as "--move 0:0,3.5,0". For each edit it calls a
// function of <relidar/run/edit.hpp>.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/edit.hpp>

namespace relidar::cli {

/// An option of `relidar edit` with its value.
struct TypedEdit {
    std::string option;  ///< For example "--move".
    std::string value;   ///< For example "0:0,3.5,0".
};

/// Describes an option of `relidar edit` by its name, the form of its value, and its help
/// text.
struct EditOption {
    const char* option;
    const char* form;
    const char* help;
};
const std::vector<EditOption>& edit_options();

/// Result of applying an edit to a scene.
struct AppliedEdit {
    DrivingScene driving;
    std::string said;  ///< One line that describes the edit.
    std::string note;  ///< Note that is printed for the user. It is empty if there is no note.
};

/// Applies an edit to a scene and its tracks.
/// @throws UsageError that names the option and the value, if the value is malformed or
/// its track does not exist; DataError if a file is malformed
AppliedEdit apply(DrivingScene driving, const TypedEdit& edit);

}  // namespace relidar::cli
