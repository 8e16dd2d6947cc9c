// SPDX-License-Identifier: Apache-2.0
// The rules the source tree keeps, one function a rule. Each returns its violations, one line each, as "file:line: what".
#pragma once

#include <string>
#include <vector>

#include "source_tree.hpp"

namespace relidar::structure {

using Violations = std::vector<std::string>;

/// A stage includes only what its row of the table in include_rules.cpp names, and another stage only by its face.
Violations check_include_edges(const SourceTree& tree);
/// No file includes itself, directly or through others; no path of includes is longer than 8 files (from a test: 10).
Violations check_include_chains(const SourceTree& tree);
/// What <relidar/relidar.hpp> brings, all its includes followed: faces of users alone, no <relidar/stages/...>, and of what devices hold no
/// more than the list of loss terms.
Violations check_umbrella(const SourceTree& tree);
/// The table of check_include_edges has no cycle: names of stages that reach themselves.
Violations check_layer_table();
/// Whether the table has a stage of this name.
bool is_stage(const std::string& name);

/// Each kernel shaders/<stage>/<stem>.comp has a binding in src/<stage>, a test, and a row in shaders/README.md.
Violations check_kernels(const SourceTree& tree);

/// Lengths of files, functions and lines, numbers of arguments.
Violations check_budgets(const SourceTree& tree);

/// Vulkan's names occur in src/gpu and src/accel only.
Violations check_vulkan_names(const SourceTree& tree);
/// Functions declared in include/relidar say what they do.
Violations check_face_comments(const SourceTree& tree);
/// Headers that are installed name no file of the checkout but documents and other headers, which are installed with them.
Violations check_installed_names(const SourceTree& tree);
/// Each source, shader and script names its licence in its first lines.
Violations check_licence_lines(const SourceTree& tree);
/// No address of a package mirror: those come from the machine's own configuration.
Violations check_mirror_names(const SourceTree& tree);
/// README.md has blocks marked runnable, and the scripts they call exist.
Violations check_readme(const SourceTree& tree);

}  // namespace relidar::structure
