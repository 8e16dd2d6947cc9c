// SPDX-License-Identifier: Apache-2.0
#include "evaluate/evaluation.hpp"

#include <utility>

#include <nlohmann/json.hpp>

#include "ranks.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

void append_frames(std::vector<ScoredFrame>& frames, const std::string& json_text) {
    for (const Json& json : Json::parse(json_text)) {
        ScoredFrame& frame = frames.emplace_back();
        frame.frame = json.at("frame");
        frame.lidar = json.at("lidar");
        frame.time_s = json.at("time_s");
        frame.n_rays = json.at("n_rays");
        frame.rendered.trace_ms = json.at("trace_ms");
        frame.metrics = json.at("metrics").get<MetricValues>();
        for (const Json& actor : json.at("actors"))
            frame.actors.push_back(
                {actor.at("track"), actor.at("class"), actor.at("metrics").get<MetricValues>()});
    }
}

}  // namespace

Evaluation gather_evaluation(const Evaluation& local_evaluation, const MpiProcessGroup& ranks) {
    if (ranks.size() == 1) return local_evaluation;
    const std::vector<std::string> all = ranks.gather_texts(frames_json(local_evaluation).dump());
    if (!ranks.is_first()) return local_evaluation;
    std::vector<ScoredFrame> frames = local_evaluation.frames;
    for (std::size_t r = 1; r < all.size(); ++r) append_frames(frames, all[r]);
    Evaluation result = summarise(std::move(frames), {});
    result.title = local_evaluation.title;
    result.kernel_ms = local_evaluation.kernel_ms;
    return result;
}

}  // namespace relidar::cli
