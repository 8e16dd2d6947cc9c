// SPDX-License-Identifier: Apache-2.0
// An entry is read over a copy of the defaults; then it is multiplied by its logs and sequences.
#include "batch/manifest.hpp"

#include <algorithm>
#include <cctype>
#include <fstream>
#include <iterator>
#include <optional>
#include <sstream>

#include <fmt/format.h>
#define TOML_EXCEPTIONS 1
#include <toml++/toml.h>

#include "batch/logs.hpp"
#include <relidar/error.hpp>

namespace relidar {
void check_toml_depth(std::string_view text, const std::string& file);   // private header of core
}
namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using Words = std::vector<std::string>;

constexpr std::size_t kLongestName = 100;
const Words kDefaultKeys{"config", "frames", "out", "preset", "settings", "steps"};
const Words kJobKeys{"config", "frames", "log", "logs", "name", "out", "preset", "sequence", "sequences", "settings", "steps"};

/// An entry of the manifest as it stands there.
struct Entry {
    BatchJob job;   ///< what its jobs have in common
    Words logs, sequences;
    bool several_logs = false, several_sequences = false;   ///< whether it may stand for several: then its name alone is none of a job
};

/// What a message may quote.
std::string cut(const std::string& text) {
    constexpr std::size_t kMost = 80;
    return text.size() > kMost ? text.substr(0, kMost) + "..." : text;
}

std::string type_of(const toml::node& node) {
    std::ostringstream type;
    type << node.type();
    return type.str();
}

std::string text_of(const toml::node& node, const std::string& key) {
    const auto* text = node.as_string();
    if (!text) throw UsageError(fmt::format("key {}: found a TOML {}, expected a text in quotes", cut(key), type_of(node)));
    if (std::any_of(text->get().begin(), text->get().end(), [](unsigned char c) { return std::iscntrl(c) != 0; }))
        throw UsageError(fmt::format("key {}: found control characters, expected a text of one line", cut(key)));
    return text->get();
}

Words texts_of(const toml::node& node, const std::string& key) {
    const toml::array* array = node.as_array();
    if (!array) throw UsageError(fmt::format("key {}: found a TOML {}, expected a list of texts", key, type_of(node)));
    Words texts;
    for (const toml::node& element : *array) texts.push_back(text_of(element, key));
    return texts;
}

/// A setting as `--set` takes it.
std::string setting_of(const toml::node& node, const std::string& key) {
    if (const auto* integer = node.as_integer()) return fmt::format("{}", integer->get());
    if (const auto* number = node.as_floating_point()) return fmt::format("{}", number->get());
    if (const auto* boolean = node.as_boolean()) return boolean->get() ? "true" : "false";
    if (node.is_string()) return text_of(node, key);
    throw UsageError(fmt::format("key {}: found a TOML {}, expected a single value", cut(key), type_of(node)));
}

void read_settings(const toml::node& node, const std::string& prefix, std::map<std::string, std::string>& settings) {
    const toml::table* table = node.as_table();
    if (!table) throw UsageError(fmt::format("key settings: found a TOML {}, expected a table", type_of(node)));
    for (const auto& [name, value] : *table) {
        const std::string key = prefix + std::string(name.str());
        if (value.is_table()) read_settings(value, key + ".", settings);
        else settings[key] = setting_of(value, "settings." + key);
    }
}

void check_keys(const toml::table& table, const Words& known) {
    for (const auto& [key, value] : table) {
        const std::string name(key.str());
        if (std::find(known.begin(), known.end(), name) == known.end())
            throw UsageError(fmt::format("key {}: unknown{} (known: {})", cut(name), did_you_mean(name, known), fmt::join(known, ", ")));
    }
}

/// "log" or "logs": one text, or a list. @return whether it is a list
bool read_one_or_list(const toml::table& table, const std::string& one, const std::string& list, Words& words) {
    const toml::node *text = table.get(one), *texts = table.get(list);
    if (text && texts) throw UsageError(fmt::format("keys {} and {}: found both, expected one of them", one, list));
    if (text) words = {text_of(*text, one)};
    if (texts) words = texts_of(*texts, list);
    return texts != nullptr;
}

/// What a table says, over what stands in the entry.
void read_entry(const toml::table& table, Entry& entry) {
    BatchJob& job = entry.job;
    const std::pair<const char*, std::string*> texts[] = {
        {"name", &job.name}, {"frames", &job.frames}, {"preset", &job.preset}, {"config", &job.config}, {"out", &job.out}};
    for (const auto& [key, text] : texts)
        if (const toml::node* node = table.get(key)) *text = text_of(*node, key);
    if (const toml::node* node = table.get("settings")) read_settings(*node, "", job.settings);
    if (const toml::node* node = table.get("steps")) job.steps = texts_of(*node, "steps");
    entry.several_logs = read_one_or_list(table, "log", "logs", entry.logs);
    entry.several_sequences = read_one_or_list(table, "sequence", "sequences", entry.sequences);
}

void check_name(const std::string& name) {
    if (name.empty() || name.size() > kLongestName || name.front() == '.' || name.front() == '-' || name != as_name(name) ||
        name == "batch.json")
        throw UsageError(fmt::format("name: found \"{}\", expected at most {} letters, digits, \"_\", \"-\" or \".\"", cut(name),
                                     kLongestName));
}

/// The entry's name where it stands for one job; what the names of its jobs begin with where it may stand for several.
std::string name_of(const Entry& entry, const NamedLog& log, const std::string& sequence) {
    std::string name = entry.job.name;
    const auto append = [&](const std::string& part) { name += (name.empty() ? "" : "-") + part; };
    const bool named = !name.empty();
    if (!named || entry.several_logs) append(log.name);
    if (!sequence.empty() && (!named || entry.several_sequences)) append(as_name(sequence));
    return name;
}

std::vector<BatchJob> jobs_of(const Entry& entry, const std::string& place, const fs::path& folder) {
    if (entry.logs.empty()) throw UsageError("found no log, expected key log or logs");
    std::vector<BatchJob> jobs;
    for (const std::string& text : entry.logs) {
        for (const NamedLog& log : find_logs(text, entry.several_logs, folder)) {
            for (const std::string& sequence : entry.sequences.empty() ? Words{""} : entry.sequences) {
                BatchJob job = entry.job;
                job.name = name_of(entry, log, sequence);
                check_name(job.name);
                job.log = log.log;
                job.sequence = sequence;
                job.where = fmt::format("{}: job {}", place, job.name);
                jobs.push_back(std::move(job));
            }
        }
    }
    return jobs;
}

toml::table parse_toml(const std::string& text, const std::string& file) {
    check_toml_depth(text, file);
    try {
        return toml::parse(text, file);
    } catch (const toml::parse_error& error) {
        throw DataError(fmt::format("{}:{}: not valid TOML: {}", file, error.source().begin.line, cut(std::string(error.description()))));
    }
}

/// Runs `read`; what it throws gets the place in front.
template <class Read>
auto at_place(const std::string& place, const Read& read) {
    try {
        return read();
    } catch (const UsageError& error) {
        throw UsageError(fmt::format("{}: {}", place, error.what()));
    }
}

/// "manifest.toml:12: job drive5", as far as it is known before the entry is read.
std::string place_of(const toml::node& node, const std::string& file) {
    const toml::table* table = node.as_table();
    const auto name = table ? (*table)["name"].value<std::string>() : std::nullopt;
    return fmt::format("{}:{}: {}", file, node.source().begin.line, name ? "job " + as_name(name->substr(0, kLongestName)) : "[[job]]");
}

}  // namespace

std::vector<BatchJob> parse_manifest(const std::string& text, const std::string& file, const fs::path& folder) {
    const toml::table table = parse_toml(text, file);
    at_place(file, [&] { check_keys(table, {"defaults", "job"}); });
    Entry defaults;
    if (const toml::node* node = table.get("defaults")) {
        at_place(fmt::format("{}:{}: [defaults]", file, node->source().begin.line), [&] {
            if (!node->is_table()) throw UsageError(fmt::format("found a TOML {}, expected a table", type_of(*node)));
            check_keys(*node->as_table(), kDefaultKeys);
            read_entry(*node->as_table(), defaults);
        });
    }
    const toml::array* entries = table.get("job") ? table.get("job")->as_array() : nullptr;
    if (!entries || entries->empty()) throw UsageError(fmt::format("{}: found no job, expected [[job]] entries", file));
    std::vector<BatchJob> jobs;
    for (const toml::node& node : *entries) {
        const std::string place = fmt::format("{}:{}", file, node.source().begin.line);
        const auto more = at_place(place_of(node, file), [&] {
            if (!node.is_table()) throw UsageError(fmt::format("found a TOML {}, expected a table", type_of(node)));
            check_keys(*node.as_table(), kJobKeys);
            Entry entry = defaults;
            read_entry(*node.as_table(), entry);
            return jobs_of(entry, place, folder);
        });
        jobs.insert(jobs.end(), more.begin(), more.end());
    }
    return jobs;
}

BatchManifest load_manifest(const fs::path& file) {
    std::error_code failed;
    std::ifstream in(file, std::ios::binary);
    if (!in || !fs::is_regular_file(file, failed))
        throw DataError(fmt::format("{}: no file that can be read, expected the manifest of a batch (TOML)", file.string()));
    const std::string text(std::istreambuf_iterator<char>(in), {});
    BatchManifest manifest{file, {}};
    manifest.jobs = parse_manifest(text, file.string(), manifest.folder());
    return manifest;
}

}  // namespace relidar::cli
