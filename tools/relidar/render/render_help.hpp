// SPDX-License-Identifier: Apache-2.0
// Texts at the end of `relidar render --help`.
#pragma once

#include <string>

namespace relidar::cli {

/// Returns the description of the output files.
std::string make_output_files_help_text();
/// Returns the help text of the option --channels.
std::string make_channels_help_text();

}  // namespace relidar::cli
