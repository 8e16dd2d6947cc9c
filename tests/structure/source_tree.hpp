// SPDX-License-Identifier: Apache-2.0
// Reads the source tree as text for the checks of rules.hpp: files, their includes and
// their functions. It parses lines and braces of code in the format of .clang-format. It
// is not a C++ parser.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace relidar::structure {

/// A file with its full text.
struct SourceFile {
    std::string path;  ///< relative to the root, with forward slashes
    std::string text;
    /// Text in which blanks replace comments and the contents of literals. It has the
    /// same length and the same lines.
    std::string code;
    std::vector<std::string> lines;  ///< lines of the text, without line ends
};

/// An #include line that refers to a file of the project.
struct Include {
    int line = 0;        ///< counted from 1
    std::string target;  ///< path relative to the root
};

/// A declaration or definition at namespace or class scope that has a parameter list.
struct Function {
    std::string name;
    std::string scope;  ///< name of the enclosing class; empty at namespace scope
    /// text of the function before its body or semicolon, with white space collapsed
    std::string header;
    int first_line = 0;  ///< counted from 1
    int last_line = 0;   ///< line of the closing brace or semicolon
    int n_arguments = 0;
    bool has_body = false;

    int n_lines() const { return last_line - first_line + 1; }
};

/// Sources, scripts and documents of a checkout, by path. Build and output folders are
/// omitted.
using SourceTree = std::map<std::string, SourceFile>;

/// Reads a checkout.
/// @throws std::runtime_error if root is not a folder
SourceTree read_tree(const std::filesystem::path& root);

/// Makes a file of the tree from its text.
SourceFile make_file(const std::string& path, const std::string& text);

/// Returns the text with spaces in place of comments and of the contents of string and
/// character literals (also raw strings).
std::string blank_comments_and_literals(const std::string& text);

/// Returns the includes of a file that refer to files of the project: <relidar/...>, or
/// quoted paths relative to the file, src/, shaders/, include/, tests/ or the root.
std::vector<Include> list_includes(const SourceTree& tree, const SourceFile& file);

/// Returns the functions of a C++ or GLSL file, sorted by their end.
std::vector<Function> list_functions(const SourceFile& file);

/// Returns true if the text contains a word that is not a part of a longer identifier.
bool contains_word(const std::string& text, const std::string& word);

/// Returns a folder of a path. folder(path, 0) is the first folder. Returns an empty
/// string after the last folder.
std::string folder(const std::string& path, std::size_t depth);
std::string stem(const std::string& path);
bool has_extension(const std::string& path, const std::vector<std::string>& extensions);
/// Returns true if the extension of a file is that of C++ or GLSL code.
bool is_code(const std::string& path);

}  // namespace relidar::structure
