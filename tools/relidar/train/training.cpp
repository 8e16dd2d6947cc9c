// SPDX-License-Identifier: Apache-2.0
#include "train/training.hpp"

#include <algorithm>
#include <fstream>
#include <limits>

#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/files.hpp>
#include "console.hpp"
#include "freed_memory.hpp"
#include "interrupt.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

/// Formats one line of log.jsonl.
std::string progress_json(const TrainProgress& p) {
    nlohmann::ordered_json json = {{"iteration", p.iteration},
                                   {"seconds", p.seconds},
                                   {"iterations_per_second", p.iterations_per_second},
                                   {"loss", p.loss}};
    for (std::size_t k = 0; k < p.terms.size(); ++k) json[kLossTermNames[k]] = p.terms[k];
    json["surfels"] = p.n_surfels;
    if (const DensifyReport& d = p.densified; d.added || d.n_removed())
        json["densified"] = {{"added", d.added},     {"clones_wanted", d.clones}, {"splits_wanted", d.splits},
                             {"invalid", d.invalid}, {"faint", d.faint},          {"large", d.large},
                             {"outside", d.outside}};
    if (!p.densified.note.empty()) json["note"] = p.densified.note;
    return json.dump() + "\n";
}

std::string format_log(const std::vector<TrainProgress>& entries) {
    std::string text;
    for (const TrainProgress& p : entries) text += progress_json(p);
    return text;
}

/// The file log.jsonl, which gets a line per progress report. If the disk is full, prints
/// a note only once. At the end, repair() tries to write the complete file again.
class LogFile {
public:
    LogFile(fs::path path, const std::vector<TrainProgress>& earlier_entries) : path_(std::move(path)) {
        write_text_file(path_, format_log(earlier_entries));
        file_.open(path_, std::ios::binary | std::ios::app);
    }
    void append(const TrainProgress& progress) {
        if (lost_ || (file_ << progress_json(progress)).flush()) return;
        lost_ = true;
        print_warning(
            fmt::format("cannot write {}, because the disk is full or the folder was removed; training "
                        "continues without it",
                        path_.string()));
    }
    void repair(const std::vector<TrainProgress>& entries) {
        if (!lost_) return;
        try {
            write_text_file(path_, format_log(entries));
        } catch (const DataError& error) {
            print_warning(error.what());
        }
    }

private:
    fs::path path_;
    std::ofstream file_;
    bool lost_ = false;
};

/// Aligns the held-out scans to the scene and prints how far they moved. After Ctrl-C,
/// the scans keep their previous poses.
void align_held_out(Device& device, Run& run, bool quiet) {
    TerminalProgress progress(quiet);
    const HeldOutPoseReport placed =
        register_held_out(device, run, {progress_callback(progress), is_interrupted});
    end_progress();
    if (quiet || placed.scans == 0) return;
    print(
        fmt::format("corrected the poses of {} of {} held-out scans by {:.1f} mm (median), at most {:.1f} "
                    "mm, so that they fit the scene\n",
                    placed.placed, placed.scans, 1e3 * placed.median_m, 1e3 * placed.largest_m));
    std::fflush(stdout);
}

}  // namespace

void prepare_log(Log& log, const Split& split, const Config& config, bool quiet,
                 const ProcessGroup& process_group, StageTimes* stage_times) {
    TerminalProgress progress(quiet);
    const auto report_line = [&](const std::string& line) {
        constexpr std::string_view kWarningPrefix = "warning: ";
        // Warnings are printed even if `quiet` is true.
        if (line.starts_with(kWarningPrefix)) return print_warning(line.substr(kWarningPrefix.size()));
        if (quiet) return;
        end_progress();
        print(line + "\n");
        std::fflush(stdout);
    };
    prepare_log(log, split, config,
                {report_line, is_interrupted, progress_callback(progress), stage_times, process_group});
}

TrainResult train_scene(Device& device, const Log& log, const Split& split, const Config& config,
                        const fs::path& folder, bool quiet, TrainSession session) {
    // The arrays of the training need memory that earlier steps have freed.
    release_freed_memory();
    LogFile lines(folder / "log.jsonl",
                  session.start ? read_training_log(*session.start, config) : std::vector<TrainProgress>{});
    TerminalProgress progress(quiet);
    session.progress = [show = progress_callback(progress)](std::string_view description, double done) {
        if (is_interrupted())
            throw Error(ExitCode::interrupted, "interrupted before the first iteration of training");
        show(description, done);
    };
    session.stop = is_interrupted;
    session.note = print_warning;
    const TrainResult result = train(
        device, log, split, config,
        [&](const TrainProgress& line) {
            if (!line.densified.note.empty()) print_note(line.densified.note);
            const bool is_last = line.iteration == line.n_iterations;
            progress.show_text(progress_line(line), is_last);
            lines.append(line);
            return true;  // continues the training
        },
        session);
    // Writes the log again if a line could not be written.
    lines.repair(result.log);
    return result;
}

TrainingEndReason align_and_fit_noise(Device& device, Run& run, bool quiet, StageTimes& stage_times) {
    stage_times.start_stage("place");
    align_held_out(device, run, quiet);
    stage_times.start_stage("scatter");
    TerminalProgress progress(quiet);
    // After Ctrl-C, the noise of the intensities remains unknown.
    run.intensity_scatter = learn_scatter(device, run, {progress_callback(progress), is_interrupted});
    end_progress();
    if (is_interrupted()) return TrainingEndReason::stopped;
    stage_times.start_stage("save");
    save_run(run);
    return TrainingEndReason::finished;
}

TrainingEndReason train_network_with_bar(Device& device, Run& run, bool quiet,
                                         RayDropTrainingSession session) {
    TerminalProgress progress(quiet);
    session.progress = progress_callback(progress);
    session.stop = is_interrupted;
    session.note = print_warning;
    session.step = [&](const RayDropTrainProgress& p) {
        const double remaining_s = p.seconds / p.step * (p.n_steps - p.step);
        const bool is_last = p.step == p.n_steps;
        progress.show_text(fmt::format("ray-drop network, epoch {}/{}  step {}/{}  {:.2f} steps/s  remaining "
                                       "{}  loss (cross-entropy) {}  accuracy {:.4f}",
                                       p.epoch, p.n_epochs, p.step, p.n_steps, p.step / p.seconds,
                                       format_duration(remaining_s), format_number(p.entropy), p.accuracy),
                           is_last);
    };
    RayDropNetwork network = train_drops(device, run, session);
    end_progress();
    // An interrupted training returns no network.
    if (network.empty()) return TrainingEndReason::stopped;
    run.drop_network = std::move(network);
    return TrainingEndReason::finished;
}

std::string progress_line(const TrainProgress& progress) {
    std::string terms;
    for (std::size_t k = 0; k < progress.terms.size(); ++k) {
        if (progress.terms[k] != 0.0)  // The settings use this term.
            terms += fmt::format("{}{} {}", terms.empty() ? "" : " ", kLossTermNames[k],
                                 format_number(progress.terms[k]));
    }
    return fmt::format("iteration {}/{}  {:.2f} iterations/s  remaining {}  loss {} ({})", progress.iteration,
                       progress.n_iterations, progress.iterations_per_second, format_duration(progress.eta_s),
                       format_number(progress.loss), terms);
}

std::string stage_times_text(const StageTimes& stage_times) {
    std::vector<std::string> words;
    for (const StageTimes::Stage& stage : stage_times.stages())
        if (stage.seconds >= 0.1) words.push_back(fmt::format("{} {:.1f} s", stage.name, stage.seconds));
    return fmt::format("{}", fmt::join(words, ", "));
}

void append_stage_times(const fs::path& folder, const StageTimes& stage_times) {
    nlohmann::ordered_json seconds = nlohmann::ordered_json::object();
    for (const StageTimes::Stage& stage : stage_times.stages()) seconds[stage.name] = stage.seconds;
    std::ofstream file(folder / "log.jsonl", std::ios::binary | std::ios::app);
    if (!(file << nlohmann::ordered_json{{"stages_s", seconds}}.dump() << "\n"))
        print_warning(fmt::format("cannot write the times of the training stages to {}",
                                  (folder / "log.jsonl").string()));
}

void write_log(const fs::path& folder, const std::vector<TrainProgress>& entries) {
    write_text_file(folder / "log.jsonl", format_log(entries));
}

std::vector<TrainProgress> read_log(const fs::path& folder) {
    std::ifstream file(folder / "log.jsonl", std::ios::binary);
    std::vector<TrainProgress> lines;
    for (std::string line; std::getline(file, line);) {
        const nlohmann::json json = nlohmann::json::parse(line, nullptr, false);
        // Skips times of stages, and a line that was not written completely.
        if (!json.is_object() || !json.contains("iteration") || !json["iteration"].is_number_integer())
            continue;
        const auto number_of = [&](const char* key) {
            return json.contains(key) && json[key].is_number() ? json[key].get<double>() : 0.0;
        };
        TrainProgress& p = lines.emplace_back();
        p.iteration = json["iteration"].get<int>();
        p.seconds = number_of("seconds");
        p.loss = number_of("loss");
        for (std::size_t k = 0; k < p.terms.size(); ++k) p.terms[k] = number_of(kLossTermNames[k]);
        // The limits make the conversion to 32 bits well defined.
        constexpr double kMaxSurfels = std::numeric_limits<std::uint32_t>::max();
        p.n_surfels = static_cast<std::uint32_t>(std::clamp(number_of("surfels"), 0.0, kMaxSurfels));
    }
    return lines;
}

int last_iteration(const fs::path& folder) {
    const std::vector<TrainProgress> lines = read_log(folder);
    return lines.empty() ? 0 : lines.back().iteration;
}

}  // namespace relidar::cli
