// SPDX-License-Identifier: Apache-2.0
// Trains the blocks of a long log. A finished block has a file scene.json. An interrupted
// block has a checkpoint. The training can be resumed with these files alone.
#include "train/train_blocks.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/run/blocks.hpp>
#include <relidar/run/checkpoint.hpp>
#include "console.hpp"
#include "interrupt.hpp"
#include "output_folder.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

/// Returns true if a setting may differ between the blocks of a scene, which are trained
/// separately.
bool is_free(const std::string& key) {
    // Actor settings may differ, because each block lists only its own actors.
    constexpr std::array kFree{"dataset.path",           "dataset.memory_mib", "train.log_every",
                               "train.frame_memory_mib", "init.actor_classes", "init.actor_tracks"};
    constexpr std::array kFreeGroups{"train.checkpoint_minutes", "render.", "refine.", "trace.", "blocks."};
    return std::find(kFree.begin(), kFree.end(), key) != kFree.end() ||
           std::any_of(kFreeGroups.begin(), kFreeGroups.end(),
                       [&](const char* group) { return key.starts_with(group); });
}

/// Compares the settings of a trained block with the current settings.
/// @throws DataError if the block was trained with other settings
void check_settings(const fs::path& block, const Config& trained, const Config& config) {
    const std::vector<ConfigKey> was = list_config_keys(trained), is = list_config_keys(config);
    for (std::size_t i = 0; i < is.size(); ++i)
        if (!is_free(is[i].key) && was[i].value != is[i].value)
            throw DataError(fmt::format(
                "cannot resume: {} was trained with {} = {}, but now the value is {}; use the same "
                "value, or --force to train all blocks again",
                block.string(), is[i].key, was[i].value, is[i].value));
}

/// Compares the frames of a trained block with the current frames.
/// @throws DataError if the block was trained on other frames
void check_frames(const Run& trained, const BlockLog& log) {
    const auto is_same = [](const Frame& first, const Frame& second) {
        return first.index == second.index && first.lidar == second.lidar;
    };
    const std::vector<Frame>&was = trained.sequence.frames, &is = log.sequence.frames;
    if (trained.split.train != log.split.train ||
        !std::equal(was.begin(), was.end(), is.begin(), is.end(), is_same))
        throw DataError(fmt::format(
            "cannot resume: {} was trained on {} frames from {} to {}, but now it has {} frames from "
            "{} to {}; use the same frames, or --force to train all blocks again",
            trained.folder.string(), was.size(), was.front().index, was.back().index, is.size(),
            is.front().index, is.back().index));
}

/// Combines the training results of all blocks of a scene. Sums up the times and averages
/// the losses.
class Total {
public:
    void add(const std::vector<TrainProgress>& log) {
        ++n_;
        if (!log.empty()) seconds_ += log.back().seconds;
        for (std::size_t i = 0; i < log.size(); ++i) {
            if (i == sum_.log.size()) sum_.log.emplace_back();
            TrainProgress& line = sum_.log[i];
            line.iteration = log[i].iteration;
            line.loss += log[i].loss;
            line.n_surfels += log[i].n_surfels;
            line.seconds += log[i].seconds;
            for (std::size_t k = 0; k < line.terms.size(); ++k) line.terms[k] += log[i].terms[k];
        }
    }
    void add(const TrainResult& result) {
        add(result.log);
        sum_.initialise_s += result.initialise_s;
        sum_.peak_device_bytes = std::max(sum_.peak_device_bytes, result.peak_device_bytes);
        sum_.times.add(result.times);
    }
    TrainResult take(int iterations) {
        for (TrainProgress& line : sum_.log) {
            line.n_iterations = iterations;
            line.loss /= double(n_);
            for (double& term : line.terms) term /= double(n_);
            line.iterations_per_second = double(line.iteration) * double(n_) / std::max(line.seconds, 1e-9);
        }
        sum_.train_s = seconds_;
        sum_.iterations = iterations;
        return std::move(sum_);
    }

private:
    TrainResult sum_;
    std::size_t n_ = 0;
    double seconds_ = 0.0;
};

/// Trains the blocks of a run one after the other.
class BlockTrainer {
public:
    BlockTrainer(Device& device, Run& run, const BlockTraining& training)
        : device_(device),
          run_(run),
          how_(training),
          blocks_(plan_blocks(run.sequence, run.split, run.config.blocks)) {}

    TrainResult train() {
        if (!how_.quiet)
            print(fmt::format(
                "blocks  {} blocks of {:.1f} m each; each block also uses the sweeps up to {:g} m "
                "outside it{}\n",
                blocks_.size(), blocks_.front().end_m - blocks_.front().begin_m, run_.config.blocks.halo_m,
                how_.ranks.size() > 1
                    ? fmt::format("; the blocks are shared among {} MPI processes", how_.ranks.size())
                    : ""));
        std::vector<fs::path> folders;
        // Numbers of the blocks that this call did not train, because they are finished
        // or because another MPI process trains them.
        std::vector<std::size_t> others;
        for (std::size_t k = 0; k < blocks_.size(); ++k) {
            folders.push_back(get_blocks_folder(run_.folder) / fmt::format("{:03}", k));
            if (!train(k, folders.back())) others.push_back(k);
        }
        how_.ranks.wait_for_all();
        if (!how_.ranks.is_first()) return {};
        for (const std::size_t k : others) total_.add(read_log(folders[k]));
        join_blocks(run_, blocks_, folders);
        train_actors();
        TrainResult result = total_.take(run_.config.train.iterations);
        write_log(run_.folder, result.log);
        return result;
    }

private:
    /// Trains block `index` in a folder. Does nothing if the block is already trained, or
    /// if another MPI process trains it.
    /// @return true if this call has trained the block
    bool train(std::size_t index, const fs::path& folder) {
        std::error_code failed;
        // Ignores the error here, because locking the folder reports the same error
        // below.
        fs::create_directories(folder, failed);
        const std::unique_ptr<FolderLock> lock = FolderLock::try_lock(folder);
        if (!lock) return false;
        BlockLog log = load_block_log(run_.sequence, run_.split, blocks_[index], run_.config);
        if (fs::is_regular_file(folder / "scene.json", failed)) {
            const Run trained = load_run(folder);
            check_frames(trained, log);
            // Removes old checkpoints. They still exist if an earlier process was killed
            // before it removed them.
            remove_checkpoints(get_checkpoint_folder(folder));
            return false;
        }
        report_block(index, log);
        const auto start = Clock::now();
        try {
            TrainResult result = train(log, folder);
            end_progress_line();
            total_.add(result);
            save(index, std::move(log), folder, result);
        } catch (const Error& error) {
            throw Error(error.code(), add_resume_hint(fmt::format("{}: {}", get_name(index), error.what())));
        }
        seconds_ += std::chrono::duration<double>(Clock::now() - start).count();
        ++trained_;
        return true;
    }

    void train_actors() {
        Progress progress(how_.quiet);
        const auto start = Clock::now();
        const auto show = [&](int step, int n_steps) {
            const double s = std::chrono::duration<double>(Clock::now() - start).count();
            progress.show(
                fmt::format("actors in front of the joined background, step {}/{}  {:.2f} it/s  eta {}", step,
                            n_steps, step / s, format_duration(s / step * (n_steps - step))),
                step == n_steps);
        };
        try {
            if (relidar::train_actors(device_, run_, {show, is_interrupted}) == TrainingEnd::stopped)
                throw Error(ExitCode::interrupted,
                            "interrupted while actors were trained in front of the joined background");
        } catch (const Error& error) {
            throw Error(error.code(), add_resume_hint(error.what()));
        }
        end_progress_line();
    }

    /// Appends the command that resumes the training to an error message.
    std::string add_resume_hint(const std::string& description) const {
        return fmt::format("{}; the trained blocks are kept; continue with: {}", description, how_.resume);
    }

    std::string get_name(std::size_t index) const {
        return fmt::format("block {} of {}", index + 1, blocks_.size());
    }

    void save(std::size_t index, BlockLog log, const fs::path& folder, TrainResult& result) const {
        Run part{folder, log.config, std::move(log.sequence), log.split, {}, {}};
        move_result_into_run(part, result);
        remove_overlap_surfels(part.scene, run_.sequence, blocks_, index);
        save_run(part);
        remove_checkpoints(get_checkpoint_folder(folder));
    }

    TrainResult train(const BlockLog& log, const fs::path& folder) const {
        const fs::path checkpoints = get_checkpoint_folder(folder);
        const std::optional<Checkpoint> start = load_newest_checkpoint(checkpoints, note);
        const TrainSession session{checkpoints, start ? &*start : nullptr, {}, {}};
        TrainResult result =
            train_with_log(device_, log.sequence, log.split, log.config, folder, how_.quiet, session);
        if (!result.interrupted) return result;
        throw Error(ExitCode::interrupted, fmt::format("interrupted after iteration {} of {}",
                                                       result.iterations, log.config.train.iterations));
    }

    void report_block(std::size_t index, const BlockLog& log) const {
        if (how_.quiet) return;
        const double left_s =
            trained_ > 0 ? seconds_ / double(trained_) * double(blocks_.size() - index) : 0.0;
        print(fmt::format("block   {} of {}, metres {:.0f} to {:.0f}: {} training frames, {} held out{}\n",
                          index + 1, blocks_.size(), blocks_[index].begin_m, blocks_[index].end_m,
                          log.split.train.size(), log.split.test.size(),
                          left_s > 0.0 ? fmt::format("; about {} left", format_duration(left_s)) : ""));
        std::fflush(stdout);
    }

    Device& device_;
    Run& run_;
    const BlockTraining how_;
    const std::vector<Block> blocks_;
    Total total_;
    double seconds_ = 0.0;
    std::size_t trained_ = 0;
};

}  // namespace

void check_trained_blocks(const fs::path& run, const Config& config) {
    std::error_code failed;
    std::vector<fs::path> folders;
    for (const auto& entry : fs::directory_iterator(get_blocks_folder(run), failed))
        if (fs::is_regular_file(entry.path() / "scene.json", failed)) folders.push_back(entry.path());
    std::sort(folders.begin(), folders.end());
    for (const fs::path& folder : folders) {
        check_settings(folder, load_saved_config(folder / "config.toml"), config);
    }
}

TrainResult train_blocks(Device& device, Run& run, const BlockTraining& training) {
    return BlockTrainer(device, run, training).train();
}

}  // namespace relidar::cli
