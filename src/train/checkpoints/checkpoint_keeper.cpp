// SPDX-License-Identifier: Apache-2.0
#include "train/checkpoints/checkpoint_keeper.hpp"

#include <new>
#include <utility>

#include <relidar/run/run.hpp>

#include "base/fail.hpp"
#include "train/checkpoints/fingerprint.hpp"
#include "train/checkpoints/resume.hpp"
#include "train/train_loop.hpp"

namespace relidar {

namespace {
// Number of checkpoints that are kept. If a failure of the machine damages the newest
// checkpoint, the older one is used.
constexpr int kMaxCheckpoints = 2;
}  // namespace

CheckpointFolder::CheckpointFolder(std::filesystem::path folder, int newest_iteration,
                                   std::string iteration_noun, double minutes,
                                   const std::function<void(const std::string&)>& report_note,
                                   std::function<Texts()> texts)
    : folder_(std::move(folder)),
      newest_(newest_iteration),
      count_(std::move(iteration_noun)),
      minutes_(minutes),
      note_(report_note) {
    if (is_enabled()) texts_ = std::async(std::launch::async, std::move(texts));
}

bool CheckpointFolder::is_time_due() const {
    const std::chrono::duration<double> since_last = Clock::now() - last_;
    return minutes_ > 0.0 && since_last.count() >= 60.0 * minutes_;
}

/// Writes a checkpoint. If the disk or the memory is full, prints a note and training
/// continues.
/// @throws DataError if the state is not finite, because training cannot continue from it
void CheckpointFolder::save(int iteration, const std::function<void(Checkpoint&)>& add_state) {
    // Sets the time before writing. If writing fails because the disk is full, the next
    // attempt then happens after one interval, not in the next step.
    last_ = Clock::now();
    Checkpoint checkpoint{iteration, texts_.get(), {}};
    const auto failed = [&](const std::string& why) {
        const std::string safe =
            newest_ > 0 ? fmt::format("the last checkpoint was written at {} {}", count_, newest_)
                        : "no earlier checkpoint has been written";
        if (note_)
            note_(fmt::format("cannot write the checkpoint at {} {} ({}): {}", count_, iteration, safe, why));
    };
    try {
        add_state(checkpoint);
    } catch (const std::bad_alloc&) {
        return failed("not enough memory");
    }
    try {
        check_finite_arrays(checkpoint);
    } catch (const DataError& error) {
        fail("training failed at {} {}: {}", count_, iteration, error.what());
    }
    try {
        save_checkpoint(folder_, checkpoint, kMaxCheckpoints);
        newest_ = iteration;
    } catch (const DataError& error) {
        failed(error.what());
    }
}

CheckpointKeeper::CheckpointKeeper(const Log& log, const Split& split, const Config& config,
                                   const TrainSession& session)
    : config_(config.train),
      folder_(session.checkpoints, session.start ? session.start->iteration : 0, "iteration",
              config.train.checkpoint_minutes, session.note, [&log, &split, &config] {
                  return make_resume_texts(list_config_keys(config), fingerprint_log(log, split));
              }) {}

/// Returns true after a fixed number of iterations or minutes. The last iteration also
/// gets a checkpoint if the folder already has one.
bool CheckpointKeeper::is_due(int step) const {
    if (!folder_.is_enabled()) return false;
    const bool by_count = config_.checkpoint_every > 0 && step % config_.checkpoint_every == 0;
    return by_count || folder_.is_time_due() || (step == config_.iterations && folder_.newest() > 0);
}

void CheckpointKeeper::save_state(TrainLoop& loop, const TrainResult& result, double training_time_s) {
    if (!folder_.is_enabled()) return;
    folder_.save(result.iterations, [&](Checkpoint& checkpoint) {
        CheckpointWriter write(checkpoint);
        loop.save_to(checkpoint);
        write_log(write, result, training_time_s);
    });
}

}  // namespace relidar
