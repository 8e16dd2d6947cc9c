// SPDX-License-Identifier: Apache-2.0
// The source tree as text, for the checks of rules.hpp: files, their includes, their
// functions. A line-and-brace reader for code in our own format (.clang-format), not a
// parser of C++.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace relidar::structure {

/// One file, read whole.
struct SourceFile {
    std::string path;  ///< relative to the root, with forward slashes
    std::string text;
    std::string code;  ///< text with comments and the contents of literals blanked; same length, same lines
    std::vector<std::string> lines;  ///< of text, without line ends
};

/// An #include line whose target is a file of the project.
struct Include {
    int line = 0;        ///< counted from 1
    std::string target;  ///< path relative to the root
};

/// A declaration or definition at namespace or class scope that has a parameter list.
struct Function {
    std::string name;
    std::string scope;   ///< name of the class it stands in; empty at namespace scope
    std::string header;  ///< everything before the body or the semicolon, white space collapsed
    int first_line = 0;  ///< counted from 1
    int last_line = 0;   ///< of the closing brace or semicolon
    int n_arguments = 0;
    bool has_body = false;

    int n_lines() const { return last_line - first_line + 1; }
};

/// All sources, scripts and documentation of a checkout, by path. Build and output
/// folders are left out.
using SourceTree = std::map<std::string, SourceFile>;

/// Reads a checkout. @throws std::runtime_error where root is no folder
SourceTree read_tree(const std::filesystem::path& root);

/// Makes a file of the tree from its text.
SourceFile make_file(const std::string& path, const std::string& text);

/// Text with comments and the contents of string and character literals (raw ones too)
/// replaced by spaces.
std::string blank_comments_and_literals(const std::string& text);

/// Includes of a file that resolve within the project: <relidar/...>, or quoted ones
/// relative to the file, src/, shaders/, include/, tests/ or the root.
std::vector<Include> includes_of(const SourceTree& tree, const SourceFile& file);

/// Functions of a C++ or GLSL file in the order of their ends.
std::vector<Function> functions_of(const SourceFile& file);

/// Whether a word stands in the text, not as part of a longer identifier.
bool contains_word(const std::string& text, const std::string& word);

/// Path pieces: folder(path, 0) is the first folder. Empty past the last folder.
std::string folder(const std::string& path, std::size_t depth);
std::string stem(const std::string& path);
bool has_extension(const std::string& path, const std::vector<std::string>& extensions);

}  // namespace relidar::structure
