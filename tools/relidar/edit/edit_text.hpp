// SPDX-License-Identifier: Apache-2.0
// Edits as they are typed: "--move 0:0,3.5,0" to a function of <relidar/run/edit.hpp>.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/edit.hpp>

namespace relidar::cli {

/// An option of `relidar edit` with its value.
struct TypedEdit {
    std::string option;  ///< "--move"
    std::string value;   ///< "0:0,3.5,0"
};

/// What `relidar edit` understands: option, form of its value, meaning.
struct EditOption {
    const char* option;
    const char* form;
    const char* help;
};
const std::vector<EditOption>& edit_options();

/// What applying an edit gives.
struct AppliedEdit {
    DrivingScene driving;
    std::string said;  ///< what happened, one line
    std::string note;  ///< what the user should know, or empty
};

/// @throws UsageError naming option and value where they are malformed or name no track;
/// DataError for files that are
AppliedEdit apply(DrivingScene driving, const TypedEdit& edit);

}  // namespace relidar::cli
