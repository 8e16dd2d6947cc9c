// SPDX-License-Identifier: Apache-2.0
#include "train/drops/refine_keeper.hpp"

#include <algorithm>
#include <array>

#include <fmt/format.h>

#include "train/checkpoints/fingerprint.hpp"

namespace relidar {
namespace {

/// Returns true if a setting changes the rendered images or the network.
bool affects_network(const std::string& setting_key) {
    constexpr std::array kNetworkPrefixes{"refine.", "image.",       "sensor.",
                                          "init.",   "render.range", "train.seed"};
    return setting_key != "refine.enabled" && std::ranges::any_of(kNetworkPrefixes, [&](const char* group) {
               return setting_key.starts_with(group);
           });
}

std::vector<ResumeFingerprint> fingerprint_run(const Run& run) {
    std::vector<ResumeFingerprint> marks = fingerprint_log(run.sequence, run.split);
    marks.push_back(fingerprint_scene(run.scene));
    return marks;
}

std::vector<ConfigKey> list_network_settings(const Config& config) {
    std::vector<ConfigKey> settings = list_config_keys(config);
    std::erase_if(settings, [](const ConfigKey& key) { return !affects_network(key.key); });
    return settings;
}

}  // namespace

RayDropCheckpointKeeper::RayDropCheckpointKeeper(const Run& run, const RayDropTrainingSession& session)
    : folder_(session.checkpoints, session.start ? session.start->iteration : 0, "ray-drop training step",
              run.config.train.checkpoint_minutes, session.note,
              [&run] { return make_resume_texts(list_network_settings(run.config), fingerprint_run(run)); }) {
}

void RayDropCheckpointKeeper::save_due(const RayDropTrainProgress& progress, bool is_stopping,
                                       const std::function<RayDropTrainState()>& get_state) {
    const bool ends_epoch = progress.step % (progress.n_steps / progress.n_epochs) == 0;
    if (!folder_.is_enabled() || !(ends_epoch || folder_.is_time_due() || is_stopping)) return;
    folder_.save(progress.step,
                 [&](Checkpoint& checkpoint) { get_state().visit_state(CheckpointWriter(checkpoint)); });
}

RayDropTrainState read_drop_state(const Checkpoint& checkpoint) {
    RayDropTrainState state;
    state.visit_state(CheckpointReader(checkpoint));
    return state;
}

void check_drop_resume(const Checkpoint& checkpoint, const Run& run) {
    const std::string doing =
        fmt::format("cannot resume the ray-drop network from step {}", checkpoint.iteration);
    check_same(list_network_settings(run.config), checkpoint, doing);
    for (const ResumeFingerprint& mark : fingerprint_run(run)) check_same(checkpoint, mark, doing);
    read_drop_state(checkpoint);  // throws an error if the state is incomplete
}

void read_drop_settings(const Checkpoint& checkpoint, Config& config) {
    for (const auto& [key, value] : read_settings(checkpoint)) set_value(config, key, value);
}

}  // namespace relidar
