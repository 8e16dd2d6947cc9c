// SPDX-License-Identifier: Apache-2.0
// Declares the rules of the source tree, a function per rule. Each function returns the
// violations of its rule, each as a line "file:line: message".
#pragma once

#include <string>
#include <vector>

#include "source_tree.hpp"

namespace relidar::structure {

using Violations = std::vector<std::string>;

/// Checks the includes of each file. A file may include only files of its module ("room")
/// and of the modules before it in the list in include_rules.cpp. It must include other
/// modules through public headers. The reader of a dataset must not include the reader of
/// another dataset.
Violations check_include_edges(const SourceTree& tree);
/// Checks that headers of external libraries are included only in folders that may use
/// the library.
Violations check_library_headers(const SourceTree& tree);
/// Checks that no file includes itself, directly or indirectly, and that no include path
/// is longer than 8 files (10 from a test).
Violations check_include_chains(const SourceTree& tree);
/// Checks that <relidar/relidar.hpp> does not include headers for trainer developers,
/// directly or indirectly.
Violations check_umbrella(const SourceTree& tree);

/// Checks that each kernel shaders/<folder>/<stem>.comp has a binding in src/<folder>, a
/// test in tests/<folder>, and a row in shaders/README.md.
Violations check_kernels(const SourceTree& tree);

/// Checks that no struct shared by C++ and shaders has two pointers of the same
/// unspecific type (Floats, Uints, ...). RELIDAR_OF declares the contents of each
/// pointer.
Violations check_bare_pointers(const SourceTree& tree);

/// Checks that no source of the library or its tools tests the type of a primitive
/// (surfel or 3D Gaussian). Differences between primitives are columns of
/// relidar/scene/primitives.h, so that a new primitive needs no further changes.
Violations check_primitive_questions(const SourceTree& tree);

/// Checks the lengths of files, functions and lines, and the numbers of arguments.
Violations check_budgets(const SourceTree& tree);

/// Checks that no two sources in different modules ("rooms") of src/ have the same name.
Violations check_file_names(const SourceTree& tree);

/// Checks that names of Vulkan occur only in src/gpu and src/diff/accel.
Violations check_vulkan_names(const SourceTree& tree);
/// Checks that no statement of C++ or GLSL joins an assignment, a call or a `return` with
/// more work by a comma. Declarations may use commas, and so may the head of a loop.
Violations check_comma_statements(const SourceTree& tree);
/// Checks that no conditional operator `a ? b : c` is an operand of another one.
Violations check_nested_conditionals(const SourceTree& tree);
/// Checks that functions declared in include/relidar have comments.
Violations check_face_comments(const SourceTree& tree);
/// Checks that installed headers mention only documents and headers that are installed
/// too.
Violations check_installed_names(const SourceTree& tree);
/// Checks that the build compiles each test file: a CMakeLists.txt of tests/ must contain
/// its name.
Violations check_test_suites(const SourceTree& tree);
/// Checks that each source, shader and script names its licence in the first lines.
Violations check_licence_lines(const SourceTree& tree);
/// Checks that no file contains the address of a package mirror, because mirrors belong
/// to the machine's configuration.
Violations check_mirror_names(const SourceTree& tree);
/// Checks that README.md has blocks marked as runnable, and that the scripts in these
/// blocks exist.
Violations check_readme(const SourceTree& tree);
/// Checks that every name in documents (*.md) exists: links, files, folders, headers,
/// kernels, settings, commands, options and variables. Also checks documents whose names
/// are in comments.
Violations check_documents(const SourceTree& tree);

}  // namespace relidar::structure
