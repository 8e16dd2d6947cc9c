// SPDX-License-Identifier: Apache-2.0
#include "train/training.hpp"

#include <algorithm>
#include <fstream>

#include <fmt/format.h>
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

std::string format_log_line(const TrainProgress& progress) {
    nlohmann::ordered_json json = {{"iteration", progress.iteration},
                                   {"seconds", progress.seconds},
                                   {"iterations_per_second", progress.iterations_per_second},
                                   {"loss", progress.loss}};
    for (std::size_t k = 0; k < progress.terms.size(); ++k) json[kLossTermNames[k]] = progress.terms[k];
    json["surfels"] = progress.n_surfels;
    if (const DensifyReport& d = progress.densified; d.added || d.removed())
        json["densified"] = {{"added", d.added},     {"clones_wanted", d.clones}, {"splits_wanted", d.splits},
                             {"invalid", d.invalid}, {"faint", d.faint},          {"large", d.large},
                             {"outside", d.outside}};
    if (!progress.densified.note.empty()) json["note"] = progress.densified.note;
    return json.dump() + "\n";
}

std::string log_text(const std::vector<TrainProgress>& lines) {
    std::string text;
    for (const TrainProgress& p : lines) text += format_log_line(p);
    return text;
}

/// Writes the file log.jsonl during training. If the disk is full, prints a note only
/// once. At the end, finish() tries to write the complete file again.
class LogFile {
public:
    LogFile(fs::path path, const std::vector<TrainProgress>& before) : path_(std::move(path)) {
        write_text(path_, log_text(before));
        file_.open(path_, std::ios::binary | std::ios::app);
    }
    void add(const TrainProgress& progress) {
        if (lost_ || (file_ << format_log_line(progress)).flush()) return;
        lost_ = true;
        note(fmt::format(
            "cannot write {}, because the disk is full or the folder was removed; training continues "
            "without it",
            path_.string()));
    }
    void finish(const std::vector<TrainProgress>& lines) {
        if (!lost_) return;
        try {
            write_text(path_, log_text(lines));
        } catch (const DataError& error) {
            note(error.what());
        }
    }

private:
    fs::path path_;
    std::ofstream file_;
    bool lost_ = false;
};

/// Aligns the held-out scans to the scene and shows the progress. Prints how far the
/// scans moved. After Ctrl-C, the scans keep their previous poses.
void place_with_progress(Device& device, Run& run, bool quiet) {
    Progress progress(quiet);
    const HeldOutPlacement placed = place_held_out(device, run, {make_progress(progress), is_interrupted});
    end_progress_line();
    if (quiet || placed.scans == 0) return;
    print(
        fmt::format("aligned {} of {} held-out scans to the scene; they moved by {:.1f} mm (median), at most "
                    "{:.1f} mm\n",
                    placed.placed, placed.scans, 1e3 * placed.median_m, 1e3 * placed.largest_m));
    std::fflush(stdout);
}

}  // namespace

void prepare_log_with_progress(Sequence& sequence, const Split& split, const Config& config, bool quiet,
                               const ProcessGroup& group, StageTimes* stages) {
    Progress progress(quiet);
    const auto tell = [&](const std::string& line) {
        if (quiet) return;
        end_progress_line();
        print(line + "\n");
        std::fflush(stdout);
    };
    prepare_log(sequence, split, config, {tell, is_interrupted, make_progress(progress), stages, group});
}

TrainResult train_with_log(Device& device, const Sequence& sequence, const Split& split, const Config& config,
                           const fs::path& folder, bool quiet, TrainSession session) {
    release_freed_memory();
    LogFile log(folder / "log.jsonl",
                session.start ? read_resumed_log(*session.start, config) : std::vector<TrainProgress>{});
    Progress progress(quiet);
    session.progress = [show = make_progress(progress)](std::string_view description, double done) {
        if (is_interrupted())
            throw Error(ExitCode::interrupted, "interrupted while the training was prepared");
        show(description, done);
    };
    session.stop = is_interrupted;
    session.note = note;
    const TrainResult result = train(
        device, sequence, split, config,
        [&](const TrainProgress& p) {
            if (!p.densified.note.empty()) note(p.densified.note);
            progress.show(format_progress(p), p.iteration == p.n_iterations);
            log.add(p);
            return true;
        },
        session);
    log.finish(result.log);
    return result;
}

namespace {

/// Measures the noise of the LiDAR intensities and shows the progress. After Ctrl-C, the
/// noise remains unknown.
void learn_scatter_with_progress(Device& device, Run& run, bool quiet) {
    Progress progress(quiet);
    run.intensity_scatter = learn_scatter(device, run, {make_progress(progress), is_interrupted});
    end_progress_line();
}

}  // namespace

TrainingEnd complete_scene_with_progress(Device& device, Run& run, bool quiet, StageTimes& stages) {
    stages.begin("place");
    place_with_progress(device, run, quiet);
    stages.begin("scatter");
    learn_scatter_with_progress(device, run, quiet);
    if (is_interrupted()) return TrainingEnd::stopped;
    stages.begin("save");
    save_run(run);
    return TrainingEnd::finished;
}

TrainingEnd refine_with_progress(Device& device, Run& run, bool quiet, RefineSession session) {
    Progress progress(quiet);
    session.progress = make_progress(progress);
    session.stop = is_interrupted;
    session.note = note;
    session.step = [&](const RefineProgress& p) {
        const double eta_s = p.seconds / p.step * (p.n_steps - p.step);
        progress.show(
            fmt::format(
                "ray-drop network, epoch {}/{}  step {}/{}  {:.2f} it/s  eta {}  entropy {}  accuracy {:.4f}",
                p.epoch, p.n_epochs, p.step, p.n_steps, p.step / p.seconds, format_duration(eta_s),
                format_short_number(p.entropy), p.accuracy),
            p.step == p.n_steps);
    };
    DropNetwork network = refine_drops(device, run, session);
    end_progress_line();
    if (network.empty()) return TrainingEnd::stopped;
    run.drop_network = std::move(network);
    return TrainingEnd::finished;
}

std::string format_progress(const TrainProgress& progress) {
    std::string terms;
    for (std::size_t k = 0; k < progress.terms.size(); ++k) {
        if (progress.terms[k] != 0.0)
            terms += fmt::format("{}{} {}", terms.empty() ? "" : " ", kLossTermNames[k],
                                 format_short_number(progress.terms[k]));
    }
    return fmt::format("iteration {}/{}  {:.2f} it/s  eta {}  loss {} ({})", progress.iteration,
                       progress.n_iterations, progress.iterations_per_second, format_duration(progress.eta_s),
                       format_short_number(progress.loss), terms);
}

std::string format_stages(const StageTimes& times) {
    std::vector<std::string> words;
    for (const StageTimes::Stage& stage : times.stages())
        if (stage.seconds >= 0.1) words.push_back(fmt::format("{} {:.1f} s", stage.name, stage.seconds));
    return fmt::format("{}", fmt::join(words, ", "));
}

void log_stages(const fs::path& folder, const StageTimes& times) {
    nlohmann::ordered_json seconds = nlohmann::ordered_json::object();
    for (const StageTimes::Stage& stage : times.stages()) seconds[stage.name] = stage.seconds;
    std::ofstream file(folder / "log.jsonl", std::ios::binary | std::ios::app);
    if (!(file << nlohmann::ordered_json{{"stages_s", seconds}}.dump() << "\n"))
        note(fmt::format("cannot write the times of the training stages to {}",
                         (folder / "log.jsonl").string()));
}

void write_log(const fs::path& folder, const std::vector<TrainProgress>& lines) {
    write_text(folder / "log.jsonl", log_text(lines));
}

std::vector<TrainProgress> read_log(const fs::path& folder) {
    std::ifstream file(folder / "log.jsonl", std::ios::binary);
    std::vector<TrainProgress> lines;
    for (std::string line; std::getline(file, line);) {
        const nlohmann::json json = nlohmann::json::parse(line, nullptr, false);
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
        p.n_surfels = static_cast<std::uint32_t>(std::clamp(number_of("surfels"), 0.0, 4294967295.0));
    }
    return lines;
}

int read_last_logged_iteration(const fs::path& folder) {
    const std::vector<TrainProgress> lines = read_log(folder);
    return lines.empty() ? 0 : lines.back().iteration;
}

}  // namespace relidar::cli
