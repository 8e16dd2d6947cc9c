// SPDX-License-Identifier: Apache-2.0
// Writes checkpoints while a ray-drop network is trained. When training is resumed,
// checks that its inputs have not changed: the scene and the log by hash, and the
// settings by value.
#include "train/drops/refine_keeper.hpp"

#include <algorithm>
#include <array>

#include <fmt/format.h>

#include "train/checkpoints/fingerprint.hpp"

namespace relidar {
namespace {

/// Returns true if a setting changes the rendered images or the network.
bool affects_refinement(const std::string& key) {
    constexpr std::array kGroups{"refine.", "image.", "sensor.", "init.", "render.range", "train.seed"};
    return key != "refine.enabled" &&
           std::ranges::any_of(kGroups, [&](const char* group) { return key.starts_with(group); });
}

std::vector<Mark> list_marks(const Run& run) {
    std::vector<Mark> marks = list_marks(run.sequence, run.split);
    marks.push_back(hash_scene_surfels(run.scene));
    return marks;
}

/// Returns the settings, and hashes of the scene and the log, for a checkpoint.
std::map<std::string, std::string> make_texts(const Run& run) {
    std::map<std::string, std::string> texts;
    for (const ConfigKey& key : list_config_keys(run.config))
        if (affects_refinement(key.key)) add_checkpoint_text(key, texts);
    for (const Mark& mark : list_marks(run)) add_checkpoint_text(mark, texts);
    return texts;
}

}  // namespace

RefineKeeper::RefineKeeper(const Run& run, const RefineSession& session)
    : minutes_(run.config.train.checkpoint_minutes),
      folder_(session.checkpoints, session.start ? session.start->iteration : 0, "ray-drop training step",
              session.note) {
    if (folder_.wanted()) texts_ = std::async(std::launch::async, [&run] { return make_texts(run); });
}

void RefineKeeper::after_step(const RefineProgress& progress, bool stops,
                              const std::function<RefineState()>& state) {
    const bool ends_epoch = progress.step % (progress.n_steps / progress.n_epochs) == 0;
    const std::chrono::duration<double> since_last = Clock::now() - last_;
    const bool by_time = minutes_ > 0.0 && since_last.count() >= 60.0 * minutes_;
    if (!folder_.wanted() || !(ends_epoch || by_time || stops)) return;
    // Sets the time before writing. If the disk is full, the next attempt is then made
    // when the next checkpoint should be written, not immediately.
    last_ = Clock::now();
    folder_.save({progress.step, texts_.get(), {}},
                 [&](Checkpoint& checkpoint) { state().visit_state(StateWriter(checkpoint)); });
}

RefineState read_refine_state(const Checkpoint& checkpoint) {
    RefineState state;
    state.visit_state(StateReader(checkpoint));
    return state;
}

void check_refine_resumable(const Checkpoint& checkpoint, const Run& run) {
    const std::string doing =
        fmt::format("cannot resume the ray-drop network from step {}", checkpoint.iteration);
    std::vector<ConfigKey> settings = list_config_keys(run.config);
    std::erase_if(settings, [](const ConfigKey& key) { return !affects_refinement(key.key); });
    check_same(settings, checkpoint, doing);
    for (const Mark& mark : list_marks(run)) check_same(checkpoint, mark, doing);
    read_refine_state(checkpoint);  // throws an error if the state is incomplete
}

void restore_refine_settings(const Checkpoint& checkpoint, Config& config) {
    for (const auto& [key, value] : read_settings(checkpoint)) set_config_value(config, key, value);
}

}  // namespace relidar
