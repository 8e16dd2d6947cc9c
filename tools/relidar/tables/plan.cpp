// SPDX-License-Identifier: Apache-2.0
#include "tables/plan.hpp"

#include <algorithm>
#include <set>
#include <sstream>

#include <fmt/format.h>
#define TOML_EXCEPTIONS 1
#include <toml++/toml.h>

#include <relidar/error.hpp>
#include "batch/check.hpp"
#include "batch/plan.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

/// Names parted by commas, each known. @param what  of the option, for the message
std::vector<std::string> parse_names(const std::string& text, const char* what, const std::vector<std::string>& known) {
    std::vector<std::string> names;
    for (const std::string& word : split(text, ',')) {
        const std::string name = without_blanks(word);
        if (std::find(known.begin(), known.end(), name) == known.end())
            throw UsageError(fmt::format("{}: found \"{}\"{}, expected some of {}, parted by commas", what, name.substr(0, 80),
                                         did_you_mean(name, known), fmt::join(known, ",")));
        if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
    }
    return names;
}

const std::string& dataset_of(const TablesOptions& options, const PublishedPart& part) {
    return part.kind == "waymo" ? options.waymo : options.kitti360;
}

std::vector<PublishedPart> choose_parts(const TablesOptions& options) {
    std::vector<PublishedPart> parts = published_parts();
    std::vector<std::string> known;
    for (const PublishedPart& part : parts) known.push_back(part.name);
    std::vector<std::string> chosen;
    if (!options.parts.empty())
        chosen = parse_names(options.parts, "--parts", known);
    else if (options.kitti360.empty() && options.waymo.empty())
        throw UsageError("tables: found no dataset, expected --kitti360 DIR, --waymo DIR, or both");
    std::erase_if(parts, [&](const PublishedPart& part) {
        return chosen.empty() ? dataset_of(options, part).empty() : std::find(chosen.begin(), chosen.end(), part.name) == chosen.end();
    });
    return parts;
}

/// What the paper's evaluation asks for, then what the user says, then the change.
std::map<std::string, std::string> settings_of(const TablesOptions& options, const TableEntry& entry) {
    std::map<std::string, std::string> settings;
    const bool as_published = entry.preset == "paper" || entry.preset == "released";
    if (entry.part.kind == "kitti360") settings["sensor.grid"] = "kitti360";
    if (entry.part.kind == "kitti360" && as_published) settings["train.grid"] = "kitti360", settings["sensor.grid_method"] = "cast";
    std::vector<std::string> sets = options.sets;
    if (entry.change && !entry.change->setting.empty()) sets.push_back(entry.change->setting);
    for (const std::string& set : sets) settings[set.substr(0, set.find('='))] = set.substr(set.find('=') + 1);
    return settings;
}

std::string quoted(const std::string& path) {
    return "'" + absolute_path(path) + "'";
}

std::vector<std::string> steps_of(const TablesOptions& options, bool without_network) {
    const std::string lpips = options.lpips.empty() ? "" : " --lpips-weights " + quoted(options.lpips);
    std::vector<std::string> steps{"render {run} --out {job}/scans --format npz,png"};
    if (!lpips.empty()) steps.push_back("eval {run} --out {job}/scores.json" + lpips);
    if (without_network) steps.push_back("eval {run} --no-refine --out {job}/no_network.json" + lpips);
    return steps;
}

/// Why a job cannot be done, as the batch would say; empty where it can.
std::string find_problem(const TablesOptions& options, const TableEntry& entry) {
    if (entry.job.log.empty()) return fmt::format("no --{} given", entry.part.kind);
    try {
        const BatchPlan plan = plan_batch({fs::path(options.out) / "parts.toml", {entry.job}}, absolute_path(options.out), options.device);
        const std::vector<Error> problems = check_plan(plan);
        return problems.empty() ? "" : std::string(problems.front().what()).substr(entry.job.where.size() + 2);
    } catch (const Error& error) {
        return error.what();
    }
}

TableEntry make_entry(const TablesOptions& options, const PublishedPart& part, const std::string& preset, const Ablation* change) {
    TableEntry entry{part, preset, change, {}, {}, {}};
    BatchJob& job = entry.job;
    const bool is_own_run = !change || !change->setting.empty();
    const bool has_changes = options.ablation && part.kind == "kitti360" && part.is_dynamic;
    job.name = fmt::format("{}-{}{}", part.name, preset, change && is_own_run ? "-" + change->name : "");
    job.where = part.name;
    if (!dataset_of(options, part).empty()) job.log = absolute_dataset(part.kind + ":" + dataset_of(options, part));
    job.sequence = part.name;
    job.preset = preset;
    job.settings = settings_of(options, entry);
    job.steps = steps_of(options, has_changes && (!change || !is_own_run));
    const fs::path folder = entry.folder(absolute_path(options.out));
    entry.scores = is_own_run ? (options.lpips.empty() ? folder / "run/metrics.json" : folder / "scores.json") : folder / "no_network.json";
    entry.missing = find_problem(options, entry);
    return entry;
}

}  // namespace

std::vector<TableEntry> plan_tables(const TablesOptions& options) {
    std::vector<TableEntry> entries;
    for (const std::string& preset : parse_names(options.presets, "--preset", {"paper", "released", "default", "quick"})) {
        (void)resolve({preset, "", options.sets});  // a wrong setting is wrong for every part
        for (const PublishedPart& part : choose_parts(options)) {
            entries.push_back(make_entry(options, part, preset, nullptr));
            if (!options.ablation || part.kind != "kitti360" || !part.is_dynamic) continue;
            for (const Ablation& change : ablations()) entries.push_back(make_entry(options, part, preset, &change));
        }
    }
    return entries;
}

std::string manifest_text(const std::vector<TableEntry>& entries) {
    toml::array jobs;
    std::set<std::string> names;
    for (const TableEntry& entry : entries) {
        const BatchJob& job = entry.job;
        if (!entry.missing.empty() || !names.insert(job.name).second) continue;
        toml::table settings;
        toml::array steps;
        for (const auto& [key, value] : job.settings) settings.insert(key, value);
        for (const std::string& step : job.steps) steps.push_back(step);
        jobs.push_back(toml::table{{"name", job.name},
                                   {"log", job.log},
                                   {"sequence", job.sequence},
                                   {"preset", job.preset},
                                   {"settings", settings},
                                   {"steps", steps}});
    }
    std::ostringstream text;
    text << "# Written by `relidar tables`, which goes on where `relidar batch` with this file has stopped, and the other way round.\n"
         << toml::table{{"job", jobs}} << "\n";
    return text.str();
}

}  // namespace relidar::cli
