// SPDX-License-Identifier: Apache-2.0
// Parses the edits of a command line. Each option, such as "--move 0:0,3.5,0", calls a
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

/// Describes an option of `relidar edit`: its name, the form of its value, and its help
/// text.
struct EditOption {
    const char* option;
    const char* form;
    const char* help;
};
const std::vector<EditOption>& edit_options();

/// Result of an edit.
struct AppliedEdit {
    DrivingScene driving;
    std::string said;  ///< One line that describes the edit.
    std::string note;  ///< A remark for the user, or an empty text.
};

/// Applies an edit to a scene and its tracks.
/// @throws UsageError naming option and value if the value is malformed or names no
/// track; DataError if a file is malformed
AppliedEdit apply(DrivingScene driving, const TypedEdit& edit);

}  // namespace relidar::cli
