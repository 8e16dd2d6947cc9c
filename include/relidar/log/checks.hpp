// SPDX-License-Identifier: Apache-2.0
// Checks of a loaded log that make it unusable if they fail.
#pragma once

#include <relidar/log/log.hpp>

namespace relidar {

/// Id of the note that names the conventions that are guesses.
inline constexpr const char* kGuessesNote = "guesses";

/// Checks that a log can be used, for example that times ascend, numbers are finite and
/// arrays have equal lengths. load_log() calls this function.
/// @throws DataError naming the frame or box, the field and the value
void check_log(const Log& log);

}  // namespace relidar
