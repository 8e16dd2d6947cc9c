// SPDX-License-Identifier: Apache-2.0
// Sends the frame scores of all MPI processes to the first process.
#include "evaluate/evaluation.hpp"

#include <utility>

#include <nlohmann/json.hpp>

#include "ranks.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

void add_frames(std::vector<ScoredFrame>& frames, const std::string& text) {
    for (const Json& json : Json::parse(text)) {
        ScoredFrame& frame = frames.emplace_back();
        frame.frame = json.at("frame");
        frame.lidar = json.at("lidar");
        frame.time_s = json.at("time_s");
        frame.n_rays = json.at("n_rays");
        frame.rendered.trace_ms = json.at("trace_ms");
        frame.metrics = json.at("metrics").get<MetricRow>();
        for (const Json& actor : json.at("actors"))
            frame.actors.push_back(
                {actor.at("track"), actor.at("class"), actor.at("metrics").get<MetricRow>()});
    }
}

}  // namespace

Evaluation gather_evaluation(const Evaluation& local, const Ranks& ranks) {
    if (ranks.size() == 1) return local;
    const std::vector<std::string> all = ranks.gather(make_frames_json(local).dump());
    if (!ranks.is_first()) return local;
    std::vector<ScoredFrame> frames = local.frames;
    for (std::size_t r = 1; r < all.size(); ++r) add_frames(frames, all[r]);
    Evaluation evaluation = summarise(std::move(frames), {});
    evaluation.title = local.title;
    evaluation.kernel_ms = local.kernel_ms;
    return evaluation;
}

}  // namespace relidar::cli
