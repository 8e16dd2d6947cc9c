// SPDX-License-Identifier: Apache-2.0
// Checks that every name in documents exists: links and anchors, files and folders,
// headers, kernels, settings, commands and their options. Only code is checked (`spans`
// and fenced blocks), except for links and names of documents. A name in capitals (RUN,
// FILE.csv) or with <...> is a placeholder. kPlaceholders lists further placeholders.
#include <algorithm>
#include <functional>
#include <regex>
#include <set>
#include <sstream>

#include "rules.hpp"

namespace relidar::structure {
namespace {

namespace fs = std::filesystem;

using Names = std::set<std::string>;

/// Names that are placeholders, or that are created elsewhere.
const Names kPlaceholders = {
    "relidar/room/name.hpp", "src/room",
    // Placeholder for any macro. The two names above are placeholders for any header and
    // any module.
    "RELIDAR_UPPER", "kernel_params.hpp",
    "relidarTargets.cmake",  // created by the build
    "scores.md",             // written by `relidar eval --table`
};

const Names kSourceExtensions = {".cpp",   ".hpp", ".h",  ".glsl", ".comp", ".rgen", ".md",
                                 ".cmake", ".sh",  ".py", ".js",   ".css",  ".proto"};

/// Extensions of files that the program reads or writes. `word.extension` counts as such
/// a file even if `word` is a section of the settings.
const Names kFileEndings = {"json", "toml", "csv", "npz", "safetensors", "jsonl", "html",
                            "png",  "exr",  "ply", "pcd", "log",         "txt",   "svg"};

/// Code `span` or line of a fenced block. Lines that end with a backslash are joined with
/// the next line.
struct Code {
    std::string text;
    std::size_t line = 0;    ///< counted from 1
    bool is_command = true;  ///< false in blocks whose language is not a shell language
};

/// Code, prose and anchors of a document.
struct Document {
    std::string path;
    std::vector<Code> code;
    std::vector<Code> prose;  ///< lines without their code
    Names anchors;
};

std::string make_anchor(const std::string& heading) {
    std::string anchor;
    for (const char c : heading) {
        const auto byte = static_cast<unsigned char>(c);
        if (std::isalnum(byte) || byte >= 0x80 || c == '_' || c == '-')
            anchor += static_cast<char>(std::tolower(byte));
        else if (c == ' ') anchor += '-';
    }
    return anchor;
}

/// Reads the fenced block whose opening fence is line `index`. Returns the line of its
/// closing fence.
std::size_t read_block(const std::vector<std::string>& lines, std::size_t index, Document& document) {
    const std::string language = lines[index].substr(3);
    const bool shell = language.empty() || language == "sh" || language == "bash";
    bool joined = false;
    for (++index; index < lines.size() && !lines[index].starts_with("```"); ++index) {
        if (joined) document.code.back().text += " " + lines[index];
        else document.code.push_back({lines[index], index + 1, shell});
        std::string& text = document.code.back().text;
        joined = text.ends_with('\\');
        if (joined) text.pop_back();
    }
    return index;
}

/// Reads the paragraph in the lines [begin, end). A code span can continue in the next
/// line.
void read_paragraph(const std::vector<std::string>& lines, std::size_t begin, std::size_t end,
                    Document& document) {
    Code span;
    bool inside = false;
    for (std::size_t i = begin; i < end; ++i) {
        Code prose{"", i + 1, false};
        for (const char c : lines[i]) {
            if (c != '`') {
                (inside ? span : prose).text += c;
            } else if (inside) {
                document.code.push_back(span);
                inside = false;
                prose.text += ' ';
            } else {
                span = {"", i + 1, true};
                inside = true;
            }
        }
        if (inside) span.text += ' ';
        document.prose.push_back(prose);
    }
}

Document read_document(const SourceFile& file) {
    Document document{file.path, {}, {}, {}};
    const auto& lines = file.lines;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        if (lines[i].starts_with("```")) {
            i = read_block(lines, i, document);
            continue;
        }
        if (lines[i].starts_with("#"))
            document.anchors.insert(make_anchor(lines[i].substr(lines[i].find_first_not_of("# "))));
        // a code span cannot extend beyond a heading, a table row or a list item
        std::size_t end = i + 1;
        while (end < lines.size() && !lines[end].empty() && !lines[end].starts_with("```") &&
               !lines[end].starts_with("#"))
            ++end;
        read_paragraph(lines, i, end, document);
        for (std::size_t k = i + 1; k < end; ++k) i = k;
    }
    return document;
}

/// Commands and options of a program.
struct Program {
    Names commands, options;
};

/// Names that exist in the source tree.
struct Known {
    const SourceTree& tree;
    Names folders, top_folders, settings, sections;
    std::map<std::string, Program> programs;  ///< by name
};

/// Searches the sources of a folder for a pattern and returns the first group of each
/// match. If the pattern has two groups, joins the groups with a dot.
Names find_matches_in(const SourceTree& tree, const std::string& prefix, const std::regex& pattern) {
    Names matched_names;
    for (auto it = tree.lower_bound(prefix); it != tree.end() && it->first.starts_with(prefix); ++it) {
        if (!has_extension(it->first, {".cpp", ".hpp", ".h"})) continue;
        const std::string& text = it->second.text;
        for (std::sregex_iterator match(text.begin(), text.end(), pattern), end; match != end; ++match)
            matched_names.insert(match->size() > 2 ? (*match)[1].str() + "." + (*match)[2].str()
                                                   : (*match)[1].str());
    }
    return matched_names;
}

Known collect_names(const SourceTree& tree) {
    Known valid_names{tree, {}, {}, {}, {}, {}};
    for (const auto& [path, file] : tree) {
        for (fs::path parent = fs::path(path).parent_path(); !parent.empty(); parent = parent.parent_path())
            valid_names.folders.insert(parent.generic_string());
        if (path.find('/') != std::string::npos) valid_names.top_folders.insert(folder(path, 0));
    }
    valid_names.settings =
        find_matches_in(tree, "src/run/config/", std::regex(R"re(\bvisitor\(\s*"(\w+)\.(\w+)")re"));
    const std::regex term(R"(\bTERM\(\d+u, \w+, (\w+),)");
    for (const std::string& weight : find_matches_in(tree, "include/relidar/diff/loss_terms.h", term))
        valid_names.settings.insert("loss." + weight);
    for (const std::string& key : valid_names.settings)
        valid_names.sections.insert(key.substr(0, key.find('.')));
    const std::regex option(R"re("(?:-\w,)?(--[a-z][\w-]*)")re");
    const std::map<std::string, std::string> folders{{"relidar", "tools/relidar/"},
                                                     {"relidar-dev", "tools/relidar_dev/"}};
    for (const auto& [name, sources] : folders) {
        Program& program = valid_names.programs[name];
        program.commands =
            find_matches_in(tree, sources, std::regex(R"re(\bapp\.add_subcommand\(\s*"(\w+)")re"));
        program.options = find_matches_in(tree, sources, option);
        program.options.insert("--help");
    }
    // options of both programs
    valid_names.programs["relidar-dev"].options.merge(
        find_matches_in(tree, "tools/relidar/options.cpp", option));
    return valid_names;
}

bool is_placeholder(const std::string& name) {
    static const std::regex kPattern(R"(<|>|\$|~|(^|/)[A-Z][A-Z0-9_]*(\.\w+)?(/|$))");
    const std::string file = fs::path(name).filename().string();
    return kPlaceholders.contains(name) ||
           (std::regex_search(name, kPattern) && file != "README.md" && file != "LICENSE");
}

/// Expands `a.{hpp,cpp}` to a.hpp and a.cpp.
std::vector<std::string> expand_braces(const std::string& name) {
    const std::size_t open = name.find('{'), close = name.find('}', open);
    if (open == std::string::npos || close == std::string::npos) return {name};
    std::vector<std::string> names;
    std::istringstream choices(name.substr(open + 1, close - open - 1));
    for (std::string choice; std::getline(choices, choice, ',');) {
        for (const std::string& rest : expand_braces(name.substr(close + 1)))
            names.push_back(name.substr(0, open) + choice + rest);
    }
    return names;
}

/// Converts a name that contains * to a regular expression that matches the end of a
/// path.
std::regex make_pattern(const std::string& name) {
    std::string pattern = "(^|.*/)";
    for (const char c : name) {
        const bool plain = std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '/';
        if (c == '*') pattern += "[^/]*";
        else pattern += plain ? std::string(1, c) : std::string{'\\', c};
    }
    return std::regex(pattern + "$");
}

/// Returns true if a file or folder with this path exists. If `anywhere` is true, the
/// name can also be the end of a path.
bool has_path(const Known& repository, const std::string& name, bool anywhere) {
    if (repository.tree.contains(name) || repository.folders.contains(name)) return true;
    if (name.find('*') == std::string::npos && !anywhere) return false;
    const std::regex pattern = make_pattern(name);
    const auto fits = [&](const std::string& path) { return std::regex_match(path, pattern); };
    const auto file_fits = [&](const auto& entry) { return fits(entry.first); };
    return std::ranges::any_of(repository.folders, fits) || std::ranges::any_of(repository.tree, file_fits);
}

bool contains_name(const Known& repository, const std::string& prefix, const std::string& word) {
    for (auto it = repository.tree.lower_bound(prefix);
         it != repository.tree.end() && it->first.starts_with(prefix); ++it) {
        const bool text =
            has_extension(it->first, {".cpp", ".hpp", ".h", ".py", ".sh", ".cmake", ".txt", ""});
        if (text && !it->first.starts_with("tests/structure/") && contains_word(it->second.text, word))
            return true;
    }
    return false;
}

/// Returns true if a name is a kernel, a part of a stage, or a label of reported times
/// (`accel/build`).
bool is_kernel(const Known& repository, const std::string& name) {
    return has_path(repository, "shaders/" + name + ".comp", false) ||
           has_path(repository, "src/" + name, false) || contains_name(repository, "src/", name) ||
           contains_name(repository, "tools/", name);
}

/// Checks files, folders, headers and kernels.
void check_paths(const Known& repository, const Document& document, const Code& code,
                 const std::function<void(std::string)>& wrong) {
    static const std::regex kPath(R"([\w.*{},<>$~/+-]+)");
    for (std::sregex_iterator match(code.text.begin(), code.text.end(), kPath), end; match != end; ++match) {
        std::string word = match->str();
        while (!word.empty() &&
               (word.back() == '.' || word.back() == ',' || word.back() == '/' || word.back() == '>'))
            word.pop_back();
        while (word.starts_with("<") || word.starts_with("./")) word.erase(0, word.starts_with("<") ? 1 : 2);
        if (word.starts_with("relidar/tools/")) word.erase(0, 8);  // as in get_script()
        if (word.empty() || word.front() == '/' || is_placeholder(word)) continue;
        for (const std::string& name : expand_braces(word)) {
            const bool source = kSourceExtensions.contains(fs::path(name).extension().string());
            const std::string here =
                (fs::path(document.path).parent_path() / name).lexically_normal().generic_string();
            const std::string top = folder(name, 0);
            if (source) {
                if (!has_path(repository, name, true) && !has_path(repository, here, false))
                    wrong("no file " + name);
            } else if (repository.top_folders.contains(top)) {
                if (!has_path(repository, name, false)) wrong("no file or folder " + name);
            } else if (repository.folders.contains("shaders/" + name.substr(0, name.rfind('/'))) &&
                       fs::path(name).extension().empty()) {
                if (!is_kernel(repository, name)) wrong("no kernel " + name);
            }
        }
    }
}

void check_settings(const Known& repository, const Code& code,
                    const std::function<void(std::string)>& wrong) {
    static const std::regex kSetting(R"((^|[^\w/-])([a-z]+)\.([a-z][a-z0-9_]*)(?![\w(*.]))");
    for (std::sregex_iterator match(code.text.begin(), code.text.end(), kSetting), end; match != end;
         ++match) {
        const std::string section = (*match)[2], key = (*match)[3];
        if (!repository.sections.contains(section) || kFileEndings.contains(key) ||
            kSourceExtensions.contains("." + key))
            continue;
        if (!repository.settings.contains(section + "." + key)) wrong("no setting " + section + "." + key);
    }
}

/// Returns the words of a command, without variable assignments before the command and
/// without a comment.
std::vector<std::string> split_words(const std::string& command) {
    std::vector<std::string> words;
    std::istringstream in(command);
    for (std::string word; in >> word && word != "#";) {
        if (word.starts_with("[")) word.erase(0, 1);
        if (!words.empty() || word.find('=') == std::string::npos || word.starts_with("--"))
            words.push_back(word);
    }
    return words;
}

/// Returns the `--name` part of a word, or an empty string.
std::string get_option(const std::string& word) {
    std::smatch match;
    return std::regex_search(word, match, std::regex("^--[a-z][a-z0-9-]*")) ? match.str() : "";
}

/// Reports the options of a command that the program does not have and that `has_option`
/// does not accept.
void check_options(const Program& program, const std::vector<std::string>& words,
                   const std::function<bool(const std::string&)>& has_option,
                   const std::function<void(std::string)>& wrong) {
    for (const std::string& word : words) {
        const std::string option = get_option(word);
        if (option.empty() || program.options.contains(option) || kPlaceholders.contains(option) ||
            has_option(option))
            continue;
        wrong("no option " + option);
    }
}

/// Returns the path of the relidar script or benchmark that a command calls, even if it
/// does not exist. Returns an empty string for other programs.
std::string get_script(const std::string& word) {
    const std::string program = fs::path(word).filename().string();
    if (program.starts_with("relidar_bench_")) return "tools/bench/" + program.substr(14) + ".cpp";
    // relidar/ is the folder that tools/dev/bundle packs
    for (const std::string prefix : {"./", "relidar/", ""})
        if (word.starts_with(prefix + "tools/")) return word.substr(prefix.size());
    return "";
}

/// Checks a command of relidar or of a relidar script. Ignores commands of other
/// programs.
void check_command(const Known& repository, const std::vector<std::string>& words,
                   const std::function<void(std::string)>& wrong) {
    if (words.empty()) return;
    const Program& relidar = repository.programs.at("relidar");
    if (const std::string script = get_script(words[0]); !script.empty()) {
        const auto file = repository.tree.find(script);
        // see check_paths()
        if (file == repository.tree.end())
            return script.ends_with(".cpp") ? wrong("no program " + words[0]) : void();
        return check_options(
            relidar, words,
            [&](const std::string& option) { return contains_word(file->second.text, option); }, wrong);
    }
    if (words[0].starts_with("--"))  // an option without a command can belong to any program of relidar
        return check_options(
            relidar, words,
            [&](const std::string& option) { return contains_name(repository, "tools/", option); }, wrong);
    std::string name = "relidar";
    auto word = std::ranges::find_if(words, [&](const std::string& w) {
        const std::string file = fs::path(w).filename().string();
        if (!repository.programs.contains(file)) return false;
        name = file;
        return true;
    });
    if (word != words.end()) ++word;
    else if (relidar.commands.contains(words[0])) word = words.begin();
    if (word == words.end()) return;
    const Program& program = repository.programs.at(name);
    if (std::regex_match(*word, std::regex("[a-z]+")) && !program.commands.contains(*word))
        wrong("no command " + name + " " + *word);
    check_options(
        program, {word, words.end()}, [](const std::string&) { return false; }, wrong);
}

void check_commands(const Known& repository, const Code& code,
                    const std::function<void(std::string)>& wrong) {
    static const std::regex kEnd(R"(\s*(&&|\|\||[|;])\s*)");
    const std::string text = code.text.substr(0, code.text.find(" #"));
    for (std::sregex_token_iterator command(text.begin(), text.end(), kEnd, -1), end; command != end;
         ++command)
        check_command(repository, split_words(*command), wrong);
}

/// Checks environment variables and CMake options.
void check_variables(const Known& repository, const Code& code,
                     const std::function<void(std::string)>& wrong) {
    static const std::regex kVariable(R"(\bRELIDAR_[A-Z0-9_]*[A-Z0-9]\b(?!\*))");
    for (std::sregex_iterator match(code.text.begin(), code.text.end(), kVariable), end; match != end;
         ++match)
        if (!kPlaceholders.contains(match->str()) && !contains_name(repository, "", match->str()))
            wrong("no variable or option " + match->str());
}

void check_links(const Known& repository, const std::map<std::string, Document>& documents,
                 const Document& document, const Code& line, const std::function<void(std::string)>& wrong) {
    static const std::regex kLink(R"(\]\(([^)\s]*)\))");
    for (std::sregex_iterator match(line.text.begin(), line.text.end(), kLink), end; match != end; ++match) {
        const std::string link = (*match)[1], target = link.substr(0, link.find('#'));
        if (link.find("://") != std::string::npos) continue;
        const std::string path =
            target.empty()
                ? document.path
                : (fs::path(document.path).parent_path() / target).lexically_normal().generic_string();
        if (!has_path(repository, path.ends_with('/') ? path.substr(0, path.size() - 1) : path, false)) {
            wrong("no file " + path);
        } else if (link.find('#') != std::string::npos && documents.contains(path) &&
                   !documents.at(path).anchors.contains(link.substr(link.find('#') + 1))) {
            wrong("no heading for " + link);
        }
    }
}

/// Returns the documents named in a line, including names outside of code.
Code list_documents_named_in(const Code& line) {
    static const std::regex kTarget(R"(\]\([^)]*\))"), kDocument(R"([\w/.-]+\.md\b)");
    const std::string text = std::regex_replace(line.text, kTarget, "]");
    Code names{"", line.line, false};
    for (std::sregex_iterator match(text.begin(), text.end(), kDocument), end; match != end; ++match)
        names.text += match->str() + " ";
    return names;
}

/// Checks the documents named in comments of sources and scripts.
void check_comments(const Known& repository, const SourceFile& file, Violations& violations) {
    static const std::regex kComment(R"(^\s*(//|#))");
    for (std::size_t i = 0; i < file.lines.size(); ++i) {
        if (file.lines[i].find(".md") == std::string::npos || !std::regex_search(file.lines[i], kComment))
            continue;
        const Document document{file.path, {}, {}, {}};
        check_paths(repository, document, list_documents_named_in({file.lines[i], i + 1, false}),
                    [&](const std::string& description) {
                        violations.push_back(file.path + ":" + std::to_string(i + 1) + ": " + description);
                    });
    }
}

}  // namespace

Violations check_documents(const SourceTree& tree) {
    const Known valid_names = collect_names(tree);
    std::map<std::string, Document> documents;
    Violations violations;
    for (const auto& [path, file] : tree) {
        if (has_extension(path, {".md"})) documents.emplace(path, read_document(file));
        else check_comments(valid_names, file, violations);
    }
    if (valid_names.settings.empty() || valid_names.programs.at("relidar").commands.empty())
        violations.push_back("src/run/config:1: settings or commands were not found");
    for (const auto& [path, document] : documents) {
        if (path == "docs/changelog.md") continue;  // skipped because it names things that were removed
        const auto reporter = [&](const Code& code) {
            return [&violations, where = path + ":" + std::to_string(code.line) + ": "](
                       const std::string& description) { violations.push_back(where + description); };
        };
        for (const Code& code : document.code) {
            check_paths(valid_names, document, code, reporter(code));
            check_settings(valid_names, code, reporter(code));
            if (code.is_command) check_commands(valid_names, code, reporter(code));
            check_variables(valid_names, code, reporter(code));
        }
        for (const Code& line : document.prose) {
            check_links(valid_names, documents, document, line, reporter(line));
            check_paths(valid_names, document, list_documents_named_in(line), reporter(line));
        }
    }
    return violations;
}

}  // namespace relidar::structure
