// SPDX-License-Identifier: Apache-2.0
#include "batch/plan.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "console.hpp"
#include "options.hpp"
#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using Words = std::vector<std::string>;
using Places = std::vector<std::pair<std::string, std::string>>;   ///< what stands in braces, and what for

/// A command that may be a step, and what it is always given, so that it may be called again where it was stopped half-way.
struct StepCommand {
    const char* name;
    const char* again;   ///< replaces what the first call has left, or goes on with it; empty: nothing need be said
    bool takes_device;
};
constexpr StepCommand kSteps[] = {{"refine", "--resume", true}, {"render", "--overwrite", true}, {"eval", "", true},
                                  {"edit", "--force", false},    {"export", "", false},           {"import", "--force", false},
                                  {"info", "", false}};

const StepCommand& find_step(const Words& words) {
    const std::string name = words.empty() ? "" : words.front();
    std::vector<std::string> names;
    for (const StepCommand& step : kSteps) {
        if (name == step.name) return step;
        names.emplace_back(step.name);
    }
    throw UsageError(fmt::format("found command \"{}\"{} (a step is one of {})", name.substr(0, 80),
                                 did_you_mean(name, names), fmt::join(names, ", ")));
}

/// Words of a command line: parted by blanks, but not within quotes, which go.
Words words_of(const std::string& text) {
    Words words;
    bool inside = false;
    char quote = 0;   // the open one
    for (const char c : text) {
        if (quote == 0 && c == ' ') {
            inside = false;
            continue;
        }
        if (!inside) words.emplace_back();
        inside = true;
        if (c == quote) quote = 0;
        else if (quote == 0 && (c == '"' || c == '\'')) quote = c;
        else words.back() += c;
    }
    if (quote != 0) throw UsageError(fmt::format("found {} once, expected a pair of them", quote));
    return words;
}

/// The text with its places filled in.
std::string filled(const std::string& text, const Places& places) {
    std::string result;
    for (std::size_t at = 0; at < text.size();) {
        const std::size_t open = std::min(text.find('{', at), text.size()), close = text.find('}', open);
        result += text.substr(at, open - at);
        if (open == text.size()) break;
        const std::string name = text.substr(open, close - open + 1);
        const auto place = std::find_if(places.begin(), places.end(), [&](const auto& p) { return p.first == name; });
        if (close == std::string::npos || place == places.end()) {
            std::vector<std::string> known;
            for (const auto& p : places) known.push_back(p.first);
            throw UsageError(fmt::format("found {}, expected {}", name.substr(0, 80), fmt::join(known, ", ")));
        }
        result += place->second;
        at = close + 1;
    }
    return result;
}

std::string as_text(const Words& words) {
    std::string text;
    for (const std::string& word : words) text += (text.empty() ? "" : " ") + shell_word(word);
    return text;
}

void append(Words& words, const Words& more) { words.insert(words.end(), more.begin(), more.end()); }

/// With --resume, a training begins, goes on from its checkpoint, or does nothing where it is finished.
JobCommand training(const BatchJob& job, const fs::path& run, const DeviceChoice& device) {
    Words words{"train", job.log};
    const std::pair<const char*, const std::string*> options[] = {
        {"--sequence", &job.sequence}, {"--frames", &job.frames}, {"--preset", &job.preset}, {"--config", &job.config}};
    for (const auto& [option, value] : options)
        if (!value->empty()) append(words, {option, *value});
    for (const auto& [key, value] : job.settings) append(words, {"--set", key + "=" + value});
    const std::string text = as_text(words);
    append(words, {"--out", run.string()});
    append(words, device_words(device));
    words.emplace_back("--resume");   // last: a word behind it would be taken for a run
    return {text, words};
}

JobCommand step(const std::string& text, const Places& places, const DeviceChoice& device) {
    Words words = words_of(text);
    const StepCommand& command = find_step(words);
    for (std::string& word : words) word = filled(word, places);
    if (*command.again) words.emplace_back(command.again);
    if (command.takes_device) append(words, device_words(device));
    return {text, words};
}

/// Places of a job: its folder, and its run where the manifest does not put it elsewhere.
PlannedJob placed(const BatchJob& job, const BatchManifest& manifest, const fs::path& out) {
    const fs::path folder = out / job.name;
    if (job.out.empty()) return {job, folder, folder / "run", {}};
    return {job, folder, (manifest.folder() / filled(job.out, {{"{name}", job.name}})).lexically_normal(), {}};
}

PlannedJob with_commands(PlannedJob result, const DeviceChoice& device) {
    const BatchJob& job = result.job;
    result.commands.push_back(training(job, result.run, device));
    const Places places{{"{run}", result.run.string()}, {"{job}", result.folder.string()}, {"{name}", job.name}};
    for (const std::string& text : job.steps) {
        try {
            result.commands.push_back(step(text, places, device));
        } catch (const UsageError& error) {
            throw UsageError(fmt::format("step \"{}\": {}", text.substr(0, 200), error.what()));
        }
    }
    return result;
}

}  // namespace

BatchPlan plan_batch(const BatchManifest& manifest, const fs::path& out, const DeviceChoice& device) {
    BatchPlan plan{fs::absolute(manifest.file), out, {}};
    for (const BatchJob& job : manifest.jobs) {
        try {
            plan.jobs.push_back(with_commands(placed(job, manifest, out), device));
        } catch (const UsageError& error) {
            throw UsageError(fmt::format("{}: {}", job.where, error.what()));
        }
    }
    return plan;
}

}  // namespace relidar::cli
