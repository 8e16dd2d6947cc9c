// SPDX-License-Identifier: Apache-2.0
// Reads the source tree as text for the checks of rules.hpp: files, their includes and
// their functions. The parser works on lines and braces of our code format
// (.clang-format); it does not parse C++ in general.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace relidar::structure {

/// A source file with its text.
struct SourceFile {
    std::string path;  ///< relative to the root, with forward slashes
    std::string text;
    /// text in which comments and contents of literals are blank; same length, same lines
    std::string code;
    std::vector<std::string> lines;  ///< lines of the text, without line ends
};

/// An #include line whose target is a file of the project.
struct Include {
    int line = 0;        ///< counted from 1
    std::string target;  ///< path relative to the root
};

/// A declaration or definition at namespace or class scope that has a parameter list.
struct Function {
    std::string name;
    std::string scope;   ///< name of the enclosing class; empty at namespace scope
    std::string header;  ///< everything before the body or the semicolon, white space collapsed
    int first_line = 0;  ///< counted from 1
    int last_line = 0;   ///< of the closing brace or semicolon
    int n_arguments = 0;
    bool has_body = false;

    int n_lines() const { return last_line - first_line + 1; }
};

/// All sources, scripts and documents of a checkout by path, without build and output
/// folders.
using SourceTree = std::map<std::string, SourceFile>;

/// Reads a checkout.
/// @throws std::runtime_error if root is not a folder
SourceTree read_tree(const std::filesystem::path& root);

/// Makes a source file from its path and text.
SourceFile make_file(const std::string& path, const std::string& text);

/// Replaces comments and the contents of string and character literals (including raw
/// strings) with spaces.
std::string blank_comments_and_literals(const std::string& text);

/// Returns the includes of a file that resolve within the project: <relidar/...>, or
/// quoted includes relative to the file, src/, shaders/, include/, tests/ or the root.
std::vector<Include> includes_of(const SourceTree& tree, const SourceFile& file);

/// Returns the functions of a C++ or GLSL file, sorted by their last lines.
std::vector<Function> functions_of(const SourceFile& file);

/// Returns true if the text contains the word, not as part of a longer identifier.
bool contains_word(const std::string& text, const std::string& word);

/// Returns a folder of a path: folder(path, 0) is the first folder. Empty beyond the last
/// folder.
std::string folder(const std::string& path, std::size_t depth);
std::string stem(const std::string& path);
bool has_extension(const std::string& path, const std::vector<std::string>& extensions);

}  // namespace relidar::structure
