// SPDX-License-Identifier: Apache-2.0
// Rules of the source tree, one function per rule. Each function returns its violations,
// one per line, as "file:line: what".
#pragma once

#include <string>
#include <vector>

#include "source_tree.hpp"

namespace relidar::structure {

using Violations = std::vector<std::string>;

/// Checks that a file includes only its room and the rooms before it, that it includes
/// other rooms through public headers, and that readers do not include each other. The
/// list of rooms is in include_rules.cpp.
Violations check_include_edges(const SourceTree& tree);
/// Checks that headers of other libraries are included only in folders that may use the
/// library.
Violations check_library_headers(const SourceTree& tree);
/// Checks that no file includes itself, directly or indirectly, and that no include path
/// is longer than 8 files (10 from a test).
Violations check_include_chains(const SourceTree& tree);
/// Checks that <relidar/relidar.hpp> does not include, directly or indirectly, a header
/// that is only for writing trainers.
Violations check_umbrella(const SourceTree& tree);

/// Checks that each kernel shaders/<folder>/<stem>.comp has a binding in src/<folder>, a
/// test in tests/<folder>, and a row in shaders/README.md.
Violations check_kernels(const SourceTree& tree);

/// Checks that no struct shared by C++ and shaders has two pointers of the same bare kind
/// (Floats, Uints, ...). RELIDAR_OF states the meaning of each pointer.
Violations check_bare_pointers(const SourceTree& tree);

/// Checks that no source of the library or its tools tests for a specific primitive.
/// Differences are columns of relidar/scene/primitives.h, so that a new primitive needs
/// no other change.
Violations check_primitive_questions(const SourceTree& tree);

/// Checks the lengths of files, functions and lines, and the number of arguments.
Violations check_budgets(const SourceTree& tree);

/// Checks that Vulkan names occur only in src/gpu and src/diff/accel.
Violations check_vulkan_names(const SourceTree& tree);
/// Checks that functions declared in include/relidar have a comment.
Violations check_face_comments(const SourceTree& tree);
/// Checks that installed headers name no files of the checkout except documents and other
/// headers, which are installed too.
Violations check_installed_names(const SourceTree& tree);
/// Checks that each source, shader and script names its licence in its first lines.
Violations check_licence_lines(const SourceTree& tree);
/// Checks that no file contains the address of a package mirror, because mirrors belong
/// to the configuration of the machine.
Violations check_mirror_names(const SourceTree& tree);
/// Checks that README.md has blocks marked runnable and that the scripts they call exist.
Violations check_readme(const SourceTree& tree);
/// Checks that links, files, folders, headers, kernels, settings, commands, options and
/// variables in documents (*.md) exist, and that documents named in comments exist.
Violations check_documents(const SourceTree& tree);

}  // namespace relidar::structure
