// SPDX-License-Identifier: Apache-2.0
#include "training.hpp"

#include <fstream>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"
#include "interrupt.hpp"
#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

std::string log_line(const TrainProgress& p) {
    nlohmann::ordered_json json = {{"iteration", p.iteration}, {"seconds", p.seconds}, {"iterations_per_second", p.iterations_per_second}, {"loss", p.loss}};
    for (std::size_t k = 0; k < p.terms.size(); ++k) json[kLossTermNames[k]] = p.terms[k];
    json["surfels"] = p.n_surfels;
    if (const DensifyReport& d = p.densified; d.added || d.removed())
        json["densified"] = {{"added", d.added}, {"clones_wanted", d.clones}, {"splits_wanted", d.splits}, {"invalid", d.invalid}, {"faint", d.faint}, {"large", d.large}, {"outside", d.outside}};
    if (!p.densified.note.empty()) json["note"] = p.densified.note;
    return json.dump() + "\n";
}

}  // namespace

TrainResult train_logged(Device& device, const Sequence& sequence, const Split& split, const Config& config, const fs::path& folder, bool quiet) {
    const fs::path log_path = folder / "log.jsonl";
    std::ofstream log(log_path, std::ios::binary | std::ios::trunc);
    Progress progress(quiet);
    progress.show("initialising the scene");
    return train(device, sequence, split, config, [&](const TrainProgress& p) {
        if (!p.densified.note.empty()) {
            progress.show(p.densified.note, true);
            end_progress_line();
        }
        progress.show(progress_text(p), p.iteration == p.n_iterations);
        if (!(log << log_line(p)).flush()) throw DataError(fmt::format("writing {}: the disk is full or the folder has gone", log_path.string()));
        return !interrupted();
    });
}

std::string progress_text(const TrainProgress& p) {
    std::string terms;
    for (std::size_t k = 0; k < p.terms.size(); ++k) {
        if (p.terms[k] != 0.0) terms += fmt::format("{}{} {}", terms.empty() ? "" : " ", kLossTermNames[k], number(p.terms[k]));
    }
    return fmt::format("iteration {}/{}  {:.2f} it/s  eta {}  loss {} ({})", p.iteration, p.n_iterations, p.iterations_per_second, duration(p.eta_s), number(p.loss), terms);
}

}  // namespace relidar::cli
