// SPDX-License-Identifier: Apache-2.0
#include "source_tree.hpp"

#include <algorithm>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>
#include <stdexcept>

namespace fs = std::filesystem;

namespace relidar::structure {
namespace {

const std::set<std::string> kSkippedFolders = {".git",    "build", "demo", "runs",       ".cache",
                                               ".vscode", ".idea", "data", "__pycache__"};

bool is_skipped(const fs::path& root, const fs::directory_entry& entry) {
    const std::string name = entry.path().filename().string();
    // The file tools/demo is a script, and the folder demo/ is its output, so only
    // folders are skipped. Folders like tests/data contain no sources.
    return entry.is_directory() && (kSkippedFolders.contains(name) ||
                                    (entry.path().parent_path() == root && name.starts_with("cmake-build")));
}

std::string read_text(const fs::path& path) {
    std::ifstream in(path, std::ios::binary);
    std::ostringstream text;
    text << in.rdbuf();
    return std::move(text).str();
}

/// Returns the position after a raw string literal whose R is at `begin`, or `begin` if
/// no raw string starts at this position.
std::size_t end_of_raw_string(const std::string& text, std::size_t begin) {
    if (text.compare(begin, 2, "R\"") != 0) return begin;
    if (begin > 0 && (std::isalnum(static_cast<unsigned char>(text[begin - 1])) || text[begin - 1] == '_'))
        return begin;
    const std::size_t open = text.find('(', begin);
    if (open == std::string::npos || open - begin > 18) return begin;
    const std::string closing = ")" + text.substr(begin + 2, open - begin - 2) + "\"";
    const std::size_t close = text.find(closing, open);
    return close == std::string::npos ? text.size() : close + closing.size();
}

/// Returns the position after a quoted literal that starts at `begin`.
std::size_t end_of_quoted(const std::string& text, std::size_t begin) {
    const char quote = text[begin];
    std::size_t i = begin + 1;
    while (i < text.size() && text[i] != quote && text[i] != '\n') i += text[i] == '\\' ? 2 : 1;
    return std::min(i + 1, text.size());
}

bool is_digit_separator(const std::string& text, std::size_t index) {
    return text[index] == '\'' && index > 0 && std::isxdigit(static_cast<unsigned char>(text[index - 1])) &&
           index + 1 < text.size() && std::isxdigit(static_cast<unsigned char>(text[index + 1]));
}

/// Returns the position after the comment or literal that starts at `index`, or `index`
/// if no comment or literal starts at `index`.
std::size_t end_of_blank(const std::string& text, std::size_t index) {
    if (text.compare(index, 2, "//") == 0) return std::min(text.find('\n', index), text.size());
    if (text.compare(index, 2, "/*") == 0) {
        const std::size_t end = text.find("*/", index + 2);
        return end == std::string::npos ? text.size() : end + 2;
    }
    if (const std::size_t end = end_of_raw_string(text, index); end != index) return end;
    if (text[index] == '"' || (text[index] == '\'' && !is_digit_separator(text, index)))
        return end_of_quoted(text, index);
    return index;
}

std::string collapse_spaces(const std::string& text) {
    std::string out;
    for (const char c : text) {
        const bool space = std::isspace(static_cast<unsigned char>(c)) != 0;
        if (!space) out += c;
        else if (!out.empty() && out.back() != ' ') out += ' ';
    }
    while (!out.empty() && out.back() == ' ') out.pop_back();
    return out;
}

/// Counts the parameters in a parenthesised list.
/// @param open position of the opening parenthesis
int count_arguments(const std::string& header, std::size_t open) {
    int depth = 0, commas = 0;
    bool any = false;
    for (std::size_t i = open; i < header.size(); ++i) {
        const char c = header[i];
        if (c == '(' || c == '<' || c == '{' || c == '[') ++depth;
        else if (c == ')' || c == '>' || c == '}' || c == ']') --depth;
        else if (c == ',' && depth == 1) ++commas;
        if (depth == 0) break;
        any = any || (i > open && c != ' ');
    }
    return any ? commas + 1 : 0;
}

/// Searches for scopes and functions in code from which comments and literals were
/// removed.
class Reader {
public:
    explicit Reader(const std::string& code) : code_(code) {}

    std::vector<Function> read() {
        for (at_ = 0; at_ < code_.size(); ++at_) step(code_[at_]);
        return std::move(functions_);
    }

private:
    enum class Kind { outer, type, function, inner };
    struct Scope {
        Kind kind = Kind::outer;
        std::string name;
        Function function;
    };

    void step(char character) {
        if (character == '\n') ++line_;
        if (character == '#' && collapse_spaces(header_).empty()) return skip_directive();
        if (character == '{') return open();
        if (character == '}') return close();
        if (character == ';' && parentheses_ == 0) return end_statement();
        if (character == '(') ++parentheses_;
        if (character == ')') --parentheses_;
        if (character == ':' && (header_ == "public" || header_ == "private" || header_ == "protected"))
            return header_.clear();
        if (header_.empty() && std::isspace(static_cast<unsigned char>(character))) return;
        if (header_.empty()) header_line_ = line_;
        header_ += character;
    }

    void skip_directive() {
        for (; at_ < code_.size(); ++at_) {
            if (code_[at_] != '\n') continue;
            ++line_;
            if (code_[at_ - 1] != '\\') break;
        }
        header_.clear();
    }

    bool is_declaration_here() const {
        return scopes_.empty() || scopes_.back().kind == Kind::outer || scopes_.back().kind == Kind::type;
    }

    void open() {
        const bool initialiser =
            at_ > 0 && !std::isspace(static_cast<unsigned char>(code_[at_ - 1])) && code_[at_ - 1] != ')';
        Scope scope;
        if (!is_declaration_here() || parentheses_ > 0 || initialiser) scope.kind = Kind::inner;
        else scope = classify(collapse_spaces(header_));
        if (scope.kind == Kind::inner && is_declaration_here()) header_ += '{';
        else header_.clear();
        saved_parentheses_.push_back(parentheses_);
        parentheses_ = 0;
        scopes_.push_back(std::move(scope));
    }

    Scope classify(const std::string& header) const {
        static const std::regex kType(
            R"(^(?:template ?<.*> ?)?(?:typedef )?(struct|class|union|enum)\b[^(]*$)");
        static const std::regex kTypeName(
            R"((?:struct|class|union|enum(?: class)?) +(?:alignas ?\([^)]*\) *)?(\w+))");
        Scope scope;
        std::smatch match;
        if (header.starts_with("namespace") || header.starts_with("inline namespace") ||
            header.starts_with("extern"))
            return scope;
        if (std::regex_search(header, kType) || header.starts_with("layout")) {
            scope.kind = Kind::type;
            if (std::regex_search(header, match, kTypeName)) scope.name = match[1];
            return scope;
        }
        scope.kind = Kind::inner;
        if (header.find('(') < header.find(" = ")) {
            scope.kind = Kind::function;
            scope.function = describe(header);
        }
        return scope;
    }

    Function describe(const std::string& header) const {
        static const std::regex kName(R"((operator ?(?:\(\)|[^\s(]+)|~?\w+) ?\()");
        Function function;
        function.header = header;
        function.first_line = header_line_;
        function.scope = scopes_.empty() ? "" : scopes_.back().name;
        std::smatch match;
        if (std::regex_search(header, match, kName)) {
            function.name = match[1];
            function.n_arguments =
                count_arguments(header, static_cast<std::size_t>(match.position(0) + match.length(0)) - 1);
        }
        return function;
    }

    void close() {
        if (scopes_.empty()) return;
        Scope scope = std::move(scopes_.back());
        scopes_.pop_back();
        parentheses_ = saved_parentheses_.back();
        saved_parentheses_.pop_back();
        if (scope.kind == Kind::function) {
            scope.function.last_line = line_;
            scope.function.has_body = true;
            functions_.push_back(std::move(scope.function));
        }
        if (scope.kind == Kind::inner && is_declaration_here()) header_ += '}';
        else header_.clear();
    }

    void end_statement() {
        static const std::regex kNoFunction(
            R"(^(using|typedef|static_assert|friend|return|RELIDAR_|layout)|^(?!.*operator)[^(]*=)");
        const std::string header = collapse_spaces(header_);
        if (is_declaration_here() && header.find('(') != std::string::npos &&
            !std::regex_search(header, kNoFunction)) {
            Function function = describe(header);
            function.last_line = line_;
            functions_.push_back(std::move(function));
        }
        header_.clear();
    }

    const std::string& code_;
    std::size_t at_ = 0;
    int line_ = 1;
    int parentheses_ = 0;
    std::vector<int> saved_parentheses_;
    std::string header_;  ///< text since the last statement or brace
    int header_line_ = 1;
    std::vector<Scope> scopes_;
    std::vector<Function> functions_;
};

}  // namespace

std::string blank_comments_and_literals(const std::string& text) {
    std::string code = text;
    for (std::size_t i = 0; i < text.size();) {
        const std::size_t end = end_of_blank(text, i);
        for (std::size_t k = i; k < end; ++k) {
            if (text[k] != '\n') code[k] = ' ';
        }
        i = std::max(end, i + 1);
    }
    return code;
}

SourceFile make_file(const std::string& path, const std::string& text) {
    SourceFile file;
    file.path = path;
    file.text = text;
    file.code = blank_comments_and_literals(text);
    std::istringstream in(text);
    for (std::string line; std::getline(in, line);) file.lines.push_back(line);
    return file;
}

SourceTree read_tree(const fs::path& root) {
    if (!fs::is_directory(root)) throw std::runtime_error("reading sources: no folder " + root.string());
    SourceTree tree;
    for (auto it = fs::recursive_directory_iterator(root); it != fs::recursive_directory_iterator(); ++it) {
        if (is_skipped(root, *it)) it.disable_recursion_pending();
        if (!it->is_regular_file()) continue;
        const std::string path = fs::relative(it->path(), root).generic_string();
        tree.emplace(path, make_file(path, read_text(it->path())));
    }
    return tree;
}

std::vector<Include> list_includes(const SourceTree& tree, const SourceFile& file) {
    static const std::regex kInclude(R"(^\s*#\s*include\s*([<"])([^>"]+)[>"])");
    std::vector<Include> includes;
    for (std::size_t i = 0; i < file.lines.size(); ++i) {
        std::smatch match;
        if (!std::regex_search(file.lines[i], match, kInclude)) continue;
        std::vector<fs::path> bases = {"include"};
        if (match[1] == "\"")
            bases = {fs::path(file.path).parent_path(),
                     "src",
                     "shaders",
                     "include",
                     "tests",
                     "tests/support",
                     "tools/relidar",
                     ""};
        for (const fs::path& base : bases) {
            const std::string target = (base / match[2].str()).lexically_normal().generic_string();
            if (!tree.contains(target)) continue;
            includes.push_back({static_cast<int>(i) + 1, target});
            break;
        }
    }
    return includes;
}

std::vector<Function> list_functions(const SourceFile& file) { return Reader(file.code).read(); }

bool contains_word(const std::string& text, const std::string& word) {
    const auto is_part = [&](std::size_t index) {
        return index < text.size() &&
               (std::isalnum(static_cast<unsigned char>(text[index])) || text[index] == '_');
    };
    for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
        if ((at == 0 || !is_part(at - 1)) && !is_part(at + word.size())) return true;
    }
    return false;
}

std::string folder(const std::string& path, std::size_t depth) {
    std::size_t begin = 0;
    for (; depth > 0; --depth) {
        begin = path.find('/', begin);
        if (begin == std::string::npos) return "";
        ++begin;
    }
    const std::size_t end = path.find('/', begin);
    return end == std::string::npos ? "" : path.substr(begin, end - begin);
}

std::string stem(const std::string& path) { return fs::path(path).stem().string(); }

bool has_extension(const std::string& path, const std::vector<std::string>& extensions) {
    return std::ranges::find(extensions, fs::path(path).extension().string()) != extensions.end();
}

bool is_code(const std::string& path) {
    return has_extension(path, {".cpp", ".hpp", ".h", ".comp", ".glsl"});
}

}  // namespace relidar::structure
