// SPDX-License-Identifier: Apache-2.0
// A finished block has a file scene.json, an interrupted block has a checkpoint. The
// training can be resumed with these files alone.
#include "train/train_blocks.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include <relidar/run/blocks.hpp>
#include <relidar/run/checkpoint.hpp>
#include "base/fail.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "output_folder.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

/// Returns true if a setting may differ between the separately trained blocks of a scene,
/// because it does not change the result, or only a later step.
bool may_differ(const std::string& setting_key) {
    // The last two list actors, and a block has only those in its part of the log.
    constexpr std::array kFreeSettings{"dataset.path",           "dataset.memory_mib", "train.log_every",
                                       "train.frame_memory_mib", "init.actor_classes", "init.actor_tracks"};
    constexpr std::array kFreeGroups{"train.checkpoint_minutes", "render.", "refine.", "trace.", "blocks."};
    return std::find(kFreeSettings.begin(), kFreeSettings.end(), setting_key) != kFreeSettings.end() ||
           std::any_of(kFreeGroups.begin(), kFreeGroups.end(),
                       [&](const char* group) { return setting_key.starts_with(group); });
}

/// @throws DataError if the block was trained with other settings
void check_block_settings(const fs::path& folder, const Config& trained, const Config& current) {
    const std::vector<ConfigKey> before = list_config_keys(trained), now = list_config_keys(current);
    for (std::size_t i = 0; i < now.size(); ++i)
        if (!may_differ(now[i].key) && before[i].value != now[i].value)
            fail(
                "cannot resume: {} was trained with {} = {}, but now the value is {}; use the same value, or "
                "--force to train all blocks again",
                folder.string(), now[i].key, before[i].value, now[i].value);
}

/// Checks that a block of an earlier training has the frames that it has now.
/// @throws DataError if it was trained on other frames
void check_block_frames(const Run& trained_block, const BlockTrainingLog& current_block_log) {
    const auto is_same = [](const Frame& first, const Frame& second) {
        return first.index == second.index && first.lidar == second.lidar;
    };
    const std::vector<Frame>& before = trained_block.log.frames;
    const std::vector<Frame>& now = current_block_log.log.frames;
    if (trained_block.split.train != current_block_log.split.train ||
        !std::ranges::equal(before, now, is_same))
        fail(
            "cannot resume: {} was trained on {} frames from {} to {}, but now it has {} frames from {} to "
            "{}; use the same frames, or --force to train all blocks again",
            trained_block.folder.string(), before.size(), before.front().index, before.back().index,
            now.size(), now.front().index, now.back().index);
}

/// Sums up the times of all blocks. Averages each line of the log over its blocks.
class BlockTrainTotals {
public:
    void add_progress(const std::vector<TrainProgress>& block_progress) {
        if (!block_progress.empty()) seconds_ += block_progress.back().seconds;
        for (std::size_t i = 0; i < block_progress.size(); ++i) {
            if (i == sum_.log.size()) {
                sum_.log.emplace_back();
                n_blocks_.push_back(0);
            }
            // Line i of the sum belongs to line i in the log of each block.
            TrainProgress& line = sum_.log[i];
            ++n_blocks_[i];
            line.iteration = block_progress[i].iteration;
            line.loss += block_progress[i].loss;
            line.n_surfels += block_progress[i].n_surfels;
            line.seconds += block_progress[i].seconds;
            for (std::size_t k = 0; k < line.terms.size(); ++k) line.terms[k] += block_progress[i].terms[k];
        }
    }
    void add_result(const TrainResult& result) {
        add_progress(result.log);
        sum_.initialise_s += result.initialise_s;
        sum_.peak_device_bytes = std::max(sum_.peak_device_bytes, result.peak_device_bytes);
        sum_.times.add_times(result.times);
    }
    /// Divides losses by the number of blocks. Times and surfel counts remain sums.
    TrainResult average(int n_iterations) {
        for (std::size_t i = 0; i < sum_.log.size(); ++i) {
            TrainProgress& line = sum_.log[i];
            const double n_blocks = n_blocks_[i];
            line.n_iterations = n_iterations;
            line.loss /= n_blocks;
            for (double& term : line.terms) term /= n_blocks;
            // Each block has run this number of iterations.
            line.iterations_per_second = double(line.iteration) * n_blocks / std::max(line.seconds, 1e-9);
        }
        sum_.train_s = seconds_;
        sum_.iterations = n_iterations;
        return std::move(sum_);
    }

private:
    TrainResult sum_;
    std::vector<int> n_blocks_;  ///< Number of blocks that have this line of the log.
    double seconds_ = 0.0;
};

class BlockTrainer {
public:
    BlockTrainer(Device& device, Run& run, const BlockTrainingOptions& training)
        : device_(device),
          run_(run),
          how_(training),
          blocks_(plan_blocks(run.log, run.split, run.config.blocks)) {}

    /// Trains all blocks that are not trained yet. The first MPI process then joins their
    /// surfels and poses into one run.
    TrainResult train_all() {
        if (!how_.quiet)
            print(fmt::format(
                "blocks  {} blocks of {:.1f} m each; each block also uses the sweeps up to {:g} m outside "
                "it{}\n",
                blocks_.size(), blocks_.front().end_m - blocks_.front().begin_m, run_.config.blocks.halo_m,
                how_.ranks.size() > 1
                    ? fmt::format("; the blocks are shared among {} MPI processes", how_.ranks.size())
                    : ""));
        std::vector<fs::path> folders;
        // finished, or trained by another MPI process
        std::vector<std::size_t> others;
        for (std::size_t k = 0; k < blocks_.size(); ++k) {
            folders.push_back(blocks_folder(run_.folder) / fmt::format("{:03}", k));
            if (!train_block(k, folders.back())) others.push_back(k);
        }
        how_.ranks.barrier();
        if (!how_.ranks.is_first()) return {};
        for (const std::size_t k : others) total_.add_progress(read_log(folders[k]));
        join_blocks(run_, blocks_, folders);
        train_joined_actors();
        TrainResult result = total_.average(run_.config.train.iterations);
        write_log(run_.folder, result.log);
        return result;
    }

private:
    /// Trains one block. Does nothing if it is already trained, or if another MPI process
    /// trains it and therefore holds the lock of its folder.
    /// @return true if this call has trained the block
    bool train_block(std::size_t block_index, const fs::path& block_folder) {
        std::error_code failed;
        // Locking the folder reports the same error below.
        fs::create_directories(block_folder, failed);
        const std::unique_ptr<FolderLock> lock = FolderLock::try_lock_folder(block_folder);
        if (!lock) return false;
        BlockTrainingLog log = cut_log(run_.log, run_.split, blocks_[block_index], run_.config);
        if (fs::is_regular_file(block_folder / "scene.json", failed)) {
            const Run trained = load_run(block_folder);
            check_block_frames(trained, log);
            // Left over if an earlier process was killed.
            remove_checkpoints(checkpoint_folder(block_folder));
            return false;
        }
        print_start(block_index, log);
        const auto start = Clock::now();
        try {
            TrainResult result = train_or_resume(log, block_folder);
            end_progress();
            total_.add_result(result);
            save_block(block_index, std::move(log), block_folder, result);
        } catch (const Error& error) {
            throw Error(error.code(), with_resume_hint(fmt::format("block {} of {}: {}", block_index + 1,
                                                                   blocks_.size(), error.what())));
        }
        seconds_ += seconds_since(start);
        ++trained_;
        return true;
    }

    void train_joined_actors() {
        TerminalProgress progress(how_.quiet);
        const auto start = Clock::now();
        const auto show = [&](int step, int n_steps) {
            const double elapsed_s = seconds_since(start);
            progress.show_text(
                fmt::format("training the actors of all blocks, step {}/{}  {:.2f} steps/s  remaining {}",
                            step, n_steps, step / elapsed_s,
                            format_duration(elapsed_s / step * (n_steps - step))),
                step == n_steps);
        };
        try {
            if (relidar::train_actors(device_, run_, {show, is_interrupted}) == TrainingEndReason::stopped)
                throw Error(ExitCode::interrupted, "interrupted while the actors of all blocks were trained");
        } catch (const Error& error) {
            throw Error(error.code(), with_resume_hint(error.what()));
        }
        end_progress();
    }

    /// Appends the command that resumes the training, if any block is saved.
    std::string with_resume_hint(const std::string& error_message) const {
        std::error_code failed;
        bool has_saved_block = is_interrupted();
        for (const auto& entry : fs::directory_iterator(blocks_folder(run_.folder), failed))
            has_saved_block |= fs::exists(entry.path() / "scene.json", failed) ||
                               !list_checkpoints(checkpoint_folder(entry.path())).empty();
        if (!has_saved_block) return error_message;
        return fmt::format("{}; the trained blocks are saved; continue with: {}", error_message, how_.resume);
    }

    void save_block(std::size_t index, BlockTrainingLog block_log, const fs::path& folder,
                    TrainResult& result) const {
        Run part{folder, block_log.config, std::move(block_log.log), block_log.split, {}, {}};
        move_result(part, result);
        keep_block_surfels(part.scene, run_.log, blocks_, index);
        save_run(part);
        remove_checkpoints(checkpoint_folder(folder));
    }

    TrainResult train_or_resume(const BlockTrainingLog& block_log, const fs::path& block_folder) const {
        const fs::path checkpoints = checkpoint_folder(block_folder);
        const std::optional<Checkpoint> start = load_newest(checkpoints, print_warning);
        const TrainSession session{checkpoints, start ? &*start : nullptr, {}, {}};
        TrainResult result = train_scene(device_, block_log.log, block_log.split, block_log.config,
                                         block_folder, how_.quiet, session);
        if (!result.interrupted) return result;
        throw Error(ExitCode::interrupted, fmt::format("interrupted after iteration {} of {}",
                                                       result.iterations, block_log.config.train.iterations));
    }

    void print_start(std::size_t block_index, const BlockTrainingLog& block_log) const {
        if (how_.quiet) return;
        // Estimated from the mean time of the blocks that this process has trained.
        const double left_s =
            trained_ > 0 ? seconds_ / double(trained_) * double(blocks_.size() - block_index) : 0.0;
        print(fmt::format(
            "block   {} of {}, metres {:.0f} to {:.0f}: {} training frames, {} held out{}\n", block_index + 1,
            blocks_.size(), blocks_[block_index].begin_m, blocks_[block_index].end_m,
            block_log.split.train.size(), block_log.split.test.size(),
            left_s > 0.0 ? fmt::format("; about {} left for all blocks", format_duration(left_s)) : ""));
        std::fflush(stdout);
    }

    Device& device_;
    Run& run_;
    const BlockTrainingOptions how_;
    const std::vector<TrajectoryBlock> blocks_;
    BlockTrainTotals total_;
    double seconds_ = 0.0;
    std::size_t trained_ = 0;
};

}  // namespace

void check_blocks(const fs::path& run_folder, const Config& config) {
    std::error_code failed;
    std::vector<fs::path> folders;
    for (const auto& entry : fs::directory_iterator(blocks_folder(run_folder), failed))
        if (fs::is_regular_file(entry.path() / "scene.json", failed)) folders.push_back(entry.path());
    std::sort(folders.begin(), folders.end());
    for (const fs::path& folder : folders) {
        check_block_settings(folder, load_settings(folder / "config.toml"), config);
    }
}

TrainResult train_blocks(Device& device, Run& run, const BlockTrainingOptions& block_options) {
    return BlockTrainer(device, run, block_options).train_all();
}

}  // namespace relidar::cli
