// SPDX-License-Identifier: Apache-2.0
#include "batch/state.hpp"

#include <ctime>
#include <fstream>
#include <iterator>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/error.hpp>
#include <relidar/export.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kFile = "job.json";
constexpr const char* kFormat = "relidar batch job";
constexpr int kVersion = 1;
constexpr JobPhase kPhases[] = {JobPhase::waiting, JobPhase::running, JobPhase::done, JobPhase::failed, JobPhase::preempted};

JobPhase find_phase(const std::string& name) {
    for (const JobPhase phase : kPhases)
        if (phase_name(phase) == name) return phase;
    throw DataError(fmt::format("state: found \"{}\", expected one that relidar writes", name.substr(0, 80)));
}

JobState state_of(const Json& json) {
    if (json.at("format") != kFormat || json.at("version") != kVersion)
        throw DataError(fmt::format("format: expected \"{}\" of version {}", kFormat, kVersion));
    JobState state;
    state.phase = find_phase(json.at("state"));
    state.done = json.at("done").get<std::vector<std::string>>();
    state.doing = json.at("doing");
    state.exit_code = json.at("exit_code");
    state.message = json.at("message");
    state.attempts = json.at("attempts");
    state.seconds = json.at("seconds");
    state.host = json.at("host");
    state.process = json.at("process");
    state.changed = json.at("changed");
    state.metrics = json.at("metrics").get<std::map<std::string, double>>();
    return state;
}

}  // namespace

std::string phase_name(JobPhase phase) {
    constexpr const char* kNames[] = {"waiting", "running", "done", "failed", "preempted"};
    return kNames[static_cast<std::size_t>(phase)];
}

JobState parse_state(const std::string& text, const std::string& file) {
    const auto wrong = [&](const std::string& what) {
        return DataError(fmt::format("{}: not the state of a job as relidar batch writes it ({}); without this file the job begins again",
                                     file, what.substr(0, 200)));
    };
    try {
        return state_of(Json::parse(text));
    } catch (const Json::exception& error) {
        throw wrong(error.what());
    } catch (const DataError& error) {
        throw wrong(error.what());
    }
}

JobState load_state(const fs::path& folder) {
    const fs::path file = folder / kFile;
    std::ifstream in(file, std::ios::binary);
    if (!in) return {};
    return parse_state(std::string(std::istreambuf_iterator<char>(in), {}), file.string());
}

void save_state(const fs::path& folder, const JobState& state) {
    const Json json = {{"format", kFormat},
                       {"version", kVersion},
                       {"state", phase_name(state.phase)},
                       {"done", state.done},
                       {"doing", state.doing},
                       {"exit_code", state.exit_code},
                       {"message", state.message},
                       {"attempts", state.attempts},
                       {"seconds", state.seconds},
                       {"host", state.host},
                       {"process", state.process},
                       {"changed", utc_now()},
                       {"metrics", state.metrics}};
    write_text(folder / kFile, json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

std::string utc_now() { return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::time(nullptr))); }

}  // namespace relidar::cli
