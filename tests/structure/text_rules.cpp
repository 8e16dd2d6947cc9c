// SPDX-License-Identifier: Apache-2.0
#include "rules.hpp"

#include <algorithm>
#include <cctype>
#include <regex>
#include <set>
#include <sstream>
#include <string_view>

namespace relidar::structure {
namespace {

std::string at(const std::string& path, std::size_t line) { return path + ":" + std::to_string(line) + ": "; }

std::vector<std::string> split_lines(const std::string& text) {
    std::vector<std::string> lines;
    std::istringstream in(text);
    for (std::string line; std::getline(in, line);) lines.push_back(line);
    return lines;
}

bool is_comment(const std::string& line) {
    const std::size_t begin = line.find_first_not_of(" \t");
    return begin != std::string::npos && line.compare(begin, 2, "//") == 0;
}

/// Returns true if a function needs no comment: operators, constructors, accessors
/// without arguments, members defined in a single line, and deleted functions.
bool has_comment(const Function& function) {
    if (function.name.starts_with("operator") || function.name.starts_with("~") ||
        function.header.ends_with("= delete") || function.header.ends_with("= default")) {
        return true;
    }
    if (function.scope.empty()) return false;
    return function.name == function.scope || function.n_arguments == 0 ||
           (function.has_body && function.n_lines() == 1);
}

bool has_trailing_comment(const SourceFile& file, const Function& function) {
    for (int line = function.first_line; line <= function.last_line; ++line) {
        if (file.lines[static_cast<std::size_t>(line) - 1].find("//") != std::string::npos) return true;
    }
    return false;
}

void check_face(const SourceFile& file, Violations& violations) {
    // consecutive declarations without an empty line share the comment above them
    std::set<int> ends_of_explained;
    for (const Function& function : list_functions(file)) {
        const bool below_comment = function.first_line > 1 &&
                                   is_comment(file.lines[static_cast<std::size_t>(function.first_line) - 2]);
        const bool in_run = ends_of_explained.contains(function.first_line - 1);
        if (below_comment || in_run || has_comment(function) || has_trailing_comment(file, function)) {
            ends_of_explained.insert(function.last_line);
        } else {
            violations.push_back(at(file.path, static_cast<std::size_t>(function.first_line)) +
                                 function.name + " has no comment");
        }
    }
}

bool is_opening_bracket(char c) { return c == '(' || c == '[' || c == '{'; }
bool is_closing_bracket(char c) { return c == ')' || c == ']' || c == '}'; }

/// Returns 1 for an opening bracket, -1 for a closing bracket, 0 for other characters.
int get_change_of_depth(char c) { return int(is_opening_bracket(c)) - int(is_closing_bracket(c)); }

/// Removes `else`, and the heads of `if`, loops and `switch`, from the start of a
/// statement.
std::string_view remove_control_heads(std::string_view statement) {
    static const std::regex kHead(R"(^\s*(else\b|(if constexpr|if|for|while|switch)\s*(?=\()))");
    std::match_results<std::string_view::const_iterator> match;
    while (std::regex_search(statement.begin(), statement.end(), match, kHead)) {
        statement.remove_prefix(static_cast<std::size_t>(match.length()));
        if (match[2].length() == 0) continue;
        std::size_t end = 0;
        int depth = 0;
        do {
            depth += get_change_of_depth(statement[end]);
            ++end;
        } while (depth > 0 && end < statement.size());
        statement.remove_prefix(end);
    }
    return statement;
}

/// Returns true if a statement of blanked code consists of several expressions that are
/// joined by commas. A declaration begins with a type and a name, so that it does not
/// match.
bool has_comma_operator(std::string_view statement) {
    static const std::regex kExpression(
        R"(\s*(return\b|\+\+|--|[\w:.>*\[\]()-]+\s*([-+*/%|&^]|<<|>>)?=[^=]|[\w:.>-]+\([^]*\)\s*$)[^]*)");
    static const std::regex kInTemplateArguments(R"(\w<[^;(){}<>]*$)");
    statement = remove_control_heads(statement);
    int depth = 0;
    for (std::size_t i = 0; i < statement.size(); ++i) {
        const char c = statement[i];
        depth += get_change_of_depth(c);
        if (c != ',' || depth > 0) continue;
        const std::string first(statement.substr(0, i));
        if (!std::regex_search(first, kInTemplateArguments)) return std::regex_match(first, kExpression);
    }
    return false;
}

/// Returns the first word of a command line. For `bash word`, returns the second word.
std::string get_called_script(const std::string& command) {
    std::istringstream in(command);
    std::string word;
    in >> word;
    if (word == "bash" || word == "sh") in >> word;
    return word.starts_with("./") ? word.substr(2) : word;
}

}  // namespace

Violations check_vulkan_names(const SourceTree& tree) {
    static const std::regex kName(R"(\b(vk[A-Z]\w*|Vk[A-Z]\w*|VK_[A-Z]\w*)\b)");
    Violations violations;
    for (const auto& [path, file] : tree) {
        const std::string top = folder(path, 0);
        if (top != "src" && top != "include" && top != "tools" && path.find("tests/reference/") != 0)
            continue;
        if (path.starts_with("src/gpu/") || path.starts_with("src/diff/accel/")) continue;
        if (!has_extension(path, {".cpp", ".hpp", ".h"})) continue;
        const std::vector<std::string> lines = split_lines(file.code);
        for (std::size_t i = 0; i < lines.size(); ++i) {
            std::smatch match;
            if (std::regex_search(lines[i], match, kName))
                violations.push_back(at(path, i + 1) + match[1].str() +
                                     " outside src/gpu and src/diff/accel");
        }
    }
    return violations;
}

Violations check_comma_statements(const SourceTree& tree) {
    struct Scope {
        std::size_t statement_begin = 0;
        int depth = 0;  // of parentheses
    };
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (!is_code(path)) continue;
        const std::string_view code = file.code;
        std::vector<Scope> scopes(1);
        for (std::size_t i = 0; i < code.size(); ++i) {
            const char c = code[i];
            if (c != '{' && c != '}') scopes.back().depth += get_change_of_depth(c);
            if (c == '{') scopes.push_back({i + 1, 0});
            if (c == '}' && scopes.size() > 1) scopes.pop_back();
            Scope& scope = scopes.back();
            if (scope.depth > 0 || (c != '}' && c != ';')) continue;
            if (c == ';' &&
                has_comma_operator(code.substr(scope.statement_begin, i - scope.statement_begin))) {
                const auto n_lines_before = std::count(code.begin(), code.begin() + std::ptrdiff_t(i), '\n');
                violations.push_back(at(path, std::size_t(n_lines_before) + 1) +
                                     "a comma joins two statements");
            }
            scope.statement_begin = i + 1;
        }
    }
    return violations;
}

Violations check_nested_conditionals(const SourceTree& tree) {
    struct Scope {  // a pair of brackets
        bool is_expression_in_parentheses = false;
        bool has_conditional = false;  // in the current expression
    };
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (!is_code(path)) continue;
        std::vector<Scope> scopes(1);
        char previous = ' ';  // ignores white space
        std::size_t line = 1;
        for (const char c : file.code) {
            if (is_opening_bracket(c)) {
                const bool is_call = std::isalnum(previous) ||
                                     std::string_view("_>])").find(previous) != std::string_view::npos;
                scopes.push_back({c == '(' && !is_call, false});
            } else if (is_closing_bracket(c)) {
                if (scopes.size() > 1) scopes.pop_back();
            } else if (c == ',' || c == ';') {
                scopes.back().has_conditional = false;
            } else if (c == '?') {
                const bool is_operand =
                    scopes.back().is_expression_in_parentheses && scopes[scopes.size() - 2].has_conditional;
                if (scopes.back().has_conditional || is_operand)
                    violations.push_back(at(path, line) + "a conditional operator is nested in another one");
                scopes.back().has_conditional = true;
            }
            if (c == '\n') ++line;
            if (!std::isspace(static_cast<unsigned char>(c))) previous = c;
        }
    }
    return violations;
}

Violations check_face_comments(const SourceTree& tree) {
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (path.starts_with("include/relidar/")) check_face(file, violations);
    }
    return violations;
}

Violations check_installed_names(const SourceTree& tree) {
    static const std::regex kFile(R"([\w./-]*[\w-]\.(md|cpp|hpp|h|comp|glsl|py|sh|cmake)\b)");
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (!path.starts_with("include/relidar/")) continue;
        for (std::size_t i = 0; i < file.lines.size(); ++i) {
            if (file.lines[i].starts_with("#include")) continue;
            for (std::sregex_iterator name(file.lines[i].begin(), file.lines[i].end(), kFile), end;
                 name != end; ++name) {
                const std::string text = name->str();
                const std::string beside = path.substr(0, path.rfind('/') + 1) + text;
                const bool is_document = text.starts_with("docs/") && tree.contains(text);
                const bool is_header =
                    tree.contains("include/" + text) || tree.contains("include/relidar/" + text);
                if (!is_document && !is_header && !tree.contains(beside))
                    violations.push_back(at(path, i + 1) + "names " + text + ", which is not installed");
            }
        }
    }
    return violations;
}

Violations check_test_suites(const SourceTree& tree) {
    std::string builds;
    for (const auto& [path, file] : tree)
        if (path.starts_with("tests/") && path.ends_with("/CMakeLists.txt")) builds += file.text;
    Violations violations;
    for (const auto& [path, file] : tree)
        if (path.starts_with("tests/") && path.ends_with("_test.cpp") &&
            builds.find(path.substr(path.rfind('/') + 1)) == std::string::npos)
            violations.push_back(at(path, 1) + "no suite of a CMakeLists.txt contains this file");
    return violations;
}

Violations check_licence_lines(const SourceTree& tree) {
    Violations violations;
    for (const auto& [path, file] : tree) {
        const bool script = file.text.starts_with("#!");
        const bool source =
            has_extension(path, {".cpp", ".hpp", ".h", ".comp", ".glsl", ".cmake", ".py", ".sh", ".in"});
        if (!script && !source && !path.ends_with("CMakeLists.txt")) continue;
        const std::size_t n = std::min<std::size_t>(file.lines.size(), 3);
        const bool named =
            std::any_of(file.lines.begin(), file.lines.begin() + static_cast<std::ptrdiff_t>(n),
                        [](const std::string& line) {
                            return line.find("SPDX-License-Identifier: Apache-2.0") != std::string::npos;
                        });
        if (!named) violations.push_back(at(path, 1) + "no SPDX-License-Identifier line at the top");
    }
    return violations;
}

Violations check_mirror_names(const SourceTree& tree) {
    static const std::regex kMirror(
        R"(\b(deb|ftp|archive|security|snapshot|ports|mirrors?)[\w.-]*\.(debian|ubuntu|kernel|canonical)\.\w+)");
    Violations violations;
    for (const auto& [path, file] : tree) {
        for (std::size_t i = 0; i < file.lines.size(); ++i) {
            std::smatch match;
            if (file.lines[i].size() < 2000 && std::regex_search(file.lines[i], match, kMirror)) {
                violations.push_back(at(path, i + 1) + "names the package mirror " + match[0].str());
            }
        }
    }
    return violations;
}

Violations check_readme(const SourceTree& tree) {
    const auto readme = tree.find("README.md");
    if (readme == tree.end()) return {"README.md:1: missing"};
    Violations violations;
    int n_blocks = 0;
    bool marked = false, inside = false;
    const std::vector<std::string>& lines = readme->second.lines;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        const std::string& line = lines[i];
        if (line.starts_with("```")) {
            inside = !inside && marked;
            if (inside) ++n_blocks;
            marked = false;
        } else if (line.find("<!-- runnable -->") != std::string::npos) {
            marked = true;
        } else if (inside) {
            const std::string script = get_called_script(line);
            const bool ours = script.starts_with("tools/") || script.starts_with(".ci/");
            if (ours && !tree.contains(script))
                violations.push_back(at("README.md", i + 1) + "calls " + script + ", which does not exist");
        }
    }
    if (n_blocks == 0) violations.push_back("README.md:1: no block marked <!-- runnable -->");
    return violations;
}

}  // namespace relidar::structure
