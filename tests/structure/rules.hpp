// SPDX-License-Identifier: Apache-2.0
// The rules the source tree keeps, one function a rule. Each returns its violations, one
// line each, as "file:line: what".
#pragma once

#include <string>
#include <vector>

#include "source_tree.hpp"

namespace relidar::structure {

using Violations = std::vector<std::string>;

/// A file includes only its own room and the rooms before it, other rooms through public
/// headers, and a reader no other reader. The list of rooms is in include_rules.cpp.
Violations check_include_edges(const SourceTree& tree);
/// Headers of other libraries are included only in the folders that may use the library.
Violations check_library_headers(const SourceTree& tree);
/// No file includes itself, directly or through others; no path of includes is longer
/// than 8 files (from a test: 10).
Violations check_include_chains(const SourceTree& tree);
/// <relidar/relidar.hpp> includes, directly or through others, no header for builders of
/// trainers.
Violations check_umbrella(const SourceTree& tree);

/// Each kernel shaders/<folder>/<stem>.comp has a binding in src/<folder>, a test in
/// tests/<folder>, and a row in shaders/README.md.
Violations check_kernels(const SourceTree& tree);

/// No struct that C++ and shaders share has two pointers of one bare kind (Floats, Uints,
/// ...): RELIDAR_OF says what each holds.
Violations check_bare_pointers(const SourceTree& tree);

/// No source of the library or its tools asks which primitive something is: what differs
/// is a column of relidar/scene/primitives.h, so that a new row changes no question.
Violations check_primitive_questions(const SourceTree& tree);

/// Lengths of files, functions and lines, numbers of arguments.
Violations check_budgets(const SourceTree& tree);

/// No two sources in different rooms of src/ have the same name.
Violations check_file_names(const SourceTree& tree);

/// Vulkan's names occur in src/gpu and src/diff/accel only.
Violations check_vulkan_names(const SourceTree& tree);
/// Functions declared in include/relidar say what they do.
Violations check_face_comments(const SourceTree& tree);
/// Headers that are installed name no file of the checkout but documents and other
/// headers, which are installed with them.
Violations check_installed_names(const SourceTree& tree);
/// Each source, shader and script names its licence in its first lines.
Violations check_licence_lines(const SourceTree& tree);
/// No address of a package mirror: those come from the machine's own configuration.
Violations check_mirror_names(const SourceTree& tree);
/// README.md has blocks marked runnable, and the scripts they call exist.
Violations check_readme(const SourceTree& tree);
/// Links, files, folders, headers, kernels, settings, commands, options and variables
/// that documents (*.md) name exist, and documents that comments name.
Violations check_documents(const SourceTree& tree);

}  // namespace relidar::structure
