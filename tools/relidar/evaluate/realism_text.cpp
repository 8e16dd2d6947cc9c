// SPDX-License-Identifier: Apache-2.0
// What a classifier tells apart, as a table, a sentence, JSON and rows of a report.
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"
#include "evaluate/evaluation.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kProtocol =
    "classifier two-sample test: boosted trees learn from patches of 5 x 9 pixels of every other held-out frame, and are tried on those "
    "between, both ways; the same pixels of both scans, which return in both; points as files hold them, returned: drop_prob < 0.5; "
    "mean over frames and its standard error";

/// "likeliest" -> "likeliest scans".
std::string scans_of(const Realism::Pair& pair) { return pair.name == "control" ? "other real scans" : pair.name + " scans"; }

std::string with_error(const Estimate& estimate) { return fmt::format("{:.3f} ± {:.3f}", estimate.value, estimate.error); }

const Estimate& accuracy_of_all(const Realism::Pair& pair) { return pair.scores.back().accuracy; }

}  // namespace

std::string realism_sentence(const Realism& realism) {
    std::string text = "a classifier tells";
    for (const Realism::Pair& pair : realism.pairs)
        text += fmt::format("{} {} {}in {:.1f} %", &pair == &realism.pairs.front() ? "" : ",", scans_of(pair),
                            &pair == &realism.pairs.front() ? "from real ones " : "", 100.0 * accuracy_of_all(pair).value);
    return text + " of cases; 50 % is perfect";
}

std::string realism_table(const Realism& realism) {
    std::vector<std::vector<std::string>> rows{{"told from real scans, AUC"}};
    for (const Realism::Pair& pair : realism.pairs) rows.back().push_back(scans_of(pair));
    for (std::size_t s = 0; s < realism.pairs.front().scores.size(); ++s) {
        rows.push_back({"by " + realism.pairs.front().scores[s].sees});
        for (const Realism::Pair& pair : realism.pairs) rows.back().push_back(with_error(pair.scores[s].auc));
    }
    return table(rows) + fmt::format("realism: {} (patches of {} frames, {:.0f} s)\n", realism_sentence(realism), realism.n_moments,
                                     realism.seconds);
}

Json realism_json(const Realism& realism) {
    Json json = {{"protocol", kProtocol},
                 {"sample_seed", RealismTest::kSampleSeed},
                 {"frames", realism.n_moments},
                 {"patches", realism.n_patches},
                 {"seconds", realism.seconds}};
    for (const Realism::Pair& pair : realism.pairs)
        for (const TwoSampleScore& score : pair.scores)
            json[pair.name][score.sees] = {{"auc", score.auc.value},
                                           {"auc_error", score.auc.error},
                                           {"accuracy", score.accuracy.value},
                                           {"accuracy_error", score.accuracy.error}};
    return json;
}

MetricRow realism_row(const Realism& realism) {
    MetricRow row;
    for (const Realism::Pair& pair : realism.pairs)
        for (const TwoSampleScore& score : pair.scores) {
            row["realism/" + pair.name + "_" + score.sees + "_auc"] = score.auc.value;
            row["realism/" + pair.name + "_" + score.sees + "_told"] = score.accuracy.value;
        }
    return row;
}

}  // namespace relidar::cli
