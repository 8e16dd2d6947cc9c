// SPDX-License-Identifier: Apache-2.0
// Checkpoints of a training: due by count or time, written without ever stopping it.
#include "train/checkpoint_keeper.hpp"

#include <new>

#include <fmt/format.h>

#include <relidar/stages/checkpoint.hpp>
#include <relidar/error.hpp>
#include <relidar/run.hpp>

#include "train/resume.hpp"
#include "train/train_loop.hpp"

namespace relidar {

CheckpointKeeper::CheckpointKeeper(const Sequence& sequence, const Split& split, const Config& config, const TrainSession& session)
    : config_(config.train), session_(session), newest_(session.start ? session.start->iteration : 0) {
    if (!session.checkpoints.empty()) texts_ = training_texts(sequence, split, config);
}

bool CheckpointKeeper::due(int step) const {
    if (session_.checkpoints.empty()) return false;
    const std::chrono::duration<double> since_last = Clock::now() - last_;
    const bool by_count = config_.checkpoint_every > 0 && step % config_.checkpoint_every == 0;
    const bool by_time = config_.checkpoint_minutes > 0.0 && since_last.count() >= 60.0 * config_.checkpoint_minutes;
    return by_count || by_time || (step == config_.iterations && newest_ > 0);
}

void CheckpointKeeper::save(TrainLoop& loop, const TrainResult& result, double train_s) {
    last_ = Clock::now();   // a full disk is tried again when the next one is due
    if (session_.checkpoints.empty()) return;
    Checkpoint checkpoint{result.iterations, texts_, {}};
    const auto failed = [&](const std::string& why) {
        const std::string safe = newest_ > 0 ? fmt::format("the last one is of iteration {}", newest_) : "there is none yet";
        if (session_.note) session_.note(fmt::format("checkpoint of iteration {} not written, {}: {}", result.iterations, safe, why));
    };
    try {
        StateWriter write(checkpoint);
        loop.save(checkpoint);
        write_result(write, result, train_s);
    } catch (const std::bad_alloc&) {
        return failed("out of memory");
    }
    try {
        check_finite(checkpoint);
    } catch (const DataError& error) {
        throw DataError(fmt::format("training, iteration {}: {}", result.iterations, error.what()));
    }
    try {
        save_checkpoint(session_.checkpoints, checkpoint, config_.checkpoint_keep);
        newest_ = result.iterations;
    } catch (const DataError& error) {
        failed(error.what());
    }
}

}  // namespace relidar
