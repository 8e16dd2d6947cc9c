// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cstring>
#include <limits>
#include <new>
#include <numeric>
#include <set>
#include <span>
#include <utility>

#include <relidar/run/run.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/random.hpp"
#include "train/checkpoints/checkpoint_keeper.hpp"

namespace relidar {
namespace {

constexpr const char* kSettingPrefix = "setting/";
constexpr const char* kTrainAgainAdvice =
    "the checkpoint was probably written by another version of relidar and cannot be resumed; train again";

/// Hashes data in words of 8 bytes. Also includes the length of each part, so that moving
/// a value from one part to the next changes the hash.
class RunningHash {
public:
    template <class T, class Allocator>
    void add_to_hash(const std::vector<T, Allocator>& values) {
        add_to_hash(values.data(), values.size() * sizeof(T));
    }
    void add_to_hash(const std::string& text) { add_to_hash(text.data(), text.size()); }
    void add_to_hash(const PoseTrack& track) {
        add_to_hash(track.time_s);
        for (const Pose& pose : track.pose) {
            add_to_hash(&pose.rotation, sizeof pose.rotation);
            add_to_hash(&pose.translation, sizeof pose.translation);
        }
    }
    void add_to_hash(const void* bytes, std::size_t n_bytes) {
        for (std::size_t i = 0; i < n_bytes; i += 8) {
            std::uint64_t word = 0;
            std::memcpy(&word, static_cast<const std::byte*>(bytes) + i,
                        std::min<std::size_t>(8, n_bytes - i));
            state_ = hash_pair(state_, word);
        }
        state_ = hash_pair(state_, n_bytes);
    }
    std::string hex_digest() const { return fmt::format("{:016x}", state_); }

private:
    std::uint64_t state_ = 0;
};

/// Returns a readable text and a hash of the frames' numbers.
std::string hash_frames(const Log& log, const std::vector<int>& frame_indices) {
    std::vector<int> numbers;
    for (const int position : frame_indices) numbers.push_back(log.frames[std::size_t(position)].index);
    RunningHash hash;
    hash.add_to_hash(numbers);
    const int first = numbers.empty() ? -1 : numbers.front(), last = numbers.empty() ? -1 : numbers.back();
    return fmt::format("{} frames from {} to {} ({})", numbers.size(), first, last, hash.hex_digest());
}

/// Returns a hash of the measurements of these frames.
std::string hash_scans(const Log& log, const std::vector<int>& frame_indices) {
    RunningHash hash;
    for (const int position : frame_indices) {
        const Scan& scan = log.frames[std::size_t(position)].scan;
        hash.add_to_hash(scan.rays.direction);
        hash.add_to_hash(scan.range_m);
        hash.add_to_hash(scan.intensity);
    }
    return hash.hex_digest();
}

/// Returns a hash of all labelled boxes with their poses.
std::string hash_boxes(const Log& log) {
    RunningHash hash;
    for (const BoxTrack& box : log.boxes) {
        hash.add_to_hash(box.id);
        hash.add_to_hash(box.category);
        hash.add_to_hash(&box.size_m, sizeof box.size_m);
        hash.add_to_hash(box.world_from_box);
    }
    return hash.hex_digest();
}

void hash_surfels(RunningHash& hash, const Surfels& surfels) {
    if (surfels.size() == 0) return;
    for (const SurfelParameterGroup& group : list_groups(surfels.parameters_used())) {
        const std::span<const float> values = group.values(surfels);
        hash.add_to_hash(values.data(), values.size_bytes());
    }
}

constexpr int kMaxCheckpoints = 2;  // if a failure of the machine damages the newest, the older one is used

constexpr std::array kAfterTrainingPrefixes{"refine.", "render."};  // settings used only after training
/// Settings that do not change the result of an iteration. The contents of the log are
/// compared instead of paths.
constexpr std::array kResumeFreeSettings{"dataset.path",
                                         "dataset.sequence",
                                         "dataset.poses",
                                         "dataset.memory_mib",
                                         "train.frame_memory_mib",
                                         "train.iterations",
                                         "train.log_every",
                                         "train.checkpoint_minutes",
                                         "sensor.grid",
                                         "sensor.grid_method",
                                         "trace.chunk"};

/// Returns true if a setting may differ when training is resumed.
bool is_resume_free(const std::string& setting_key) {
    const auto is_prefix = [&](const char* prefix) { return setting_key.starts_with(prefix); };
    return std::ranges::find(kResumeFreeSettings, setting_key) != kResumeFreeSettings.end() ||
           std::ranges::any_of(kAfterTrainingPrefixes, is_prefix);
}

/// Training log with one array per column, as stored in a checkpoint.
struct LogColumns {
    std::vector<std::int32_t> iteration;
    std::vector<double> seconds;
    std::vector<std::uint32_t> surfels;
    std::array<std::vector<double>, kLossTerms> terms;
    std::array<std::vector<std::uint32_t>, kDensifyCounts.size()> densified;

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("log/iteration", iteration);
        visit("log/seconds", seconds);
        visit("log/surfels", surfels);
        for (std::size_t k = 0; k < terms.size(); ++k)
            visit(std::string("log/") + kLossTermNames[k], terms[k]);
        for (std::size_t k = 0; k < densified.size(); ++k)
            visit(std::string("log/densified/") + kDensifyCounts[k].first, densified[k]);
    }
    bool have_equal_lengths() const {
        const auto is_complete = [this](const auto& column) { return column.size() == iteration.size(); };
        return is_complete(seconds) && is_complete(surfels) && std::ranges::all_of(terms, is_complete) &&
               std::ranges::all_of(densified, is_complete);
    }
};

/// Returns count `k` of a report, in the order of kDensifyCounts.
template <class Report>
auto& densify_count(Report& report, std::size_t k) {
    return report.*kDensifyCounts[k].second;
}

/// Returns a line of the training log without remaining time and densification.
TrainProgress make_progress(int step, const Config& config, double elapsed_s,
                            const std::array<double, kLossTerms>& loss_terms, std::uint32_t n_surfels) {
    return {.iteration = step,
            .n_iterations = config.train.iterations,
            .seconds = elapsed_s,
            .iterations_per_second = step / std::max(elapsed_s, 1e-9),
            .terms = loss_terms,
            .loss = std::accumulate(loss_terms.begin(), loss_terms.end(), 0.0),
            .n_surfels = n_surfels,
            .densified = {}};
}

}  // namespace

std::vector<ResumeFingerprint> fingerprint_log(const Log& log, const Split& split) {
    RunningHash poses;
    poses.add_to_hash(log.world_from_vehicle);
    return {{"log/training frames", "the log's training frames", hash_frames(log, split.train)},
            {"log/scans", "the log's scans", hash_scans(log, split.train)},
            {"log/sensor poses", "the log's sensor poses", poses.hex_digest()},
            {"log/boxes", "the log's boxes", hash_boxes(log)}};
}

ResumeFingerprint fingerprint_scene(const Scene& scene) {
    RunningHash hash;
    hash.add_to_hash(format_layout(scene));
    hash.add_to_hash(scene.sensor_drop.probability);
    hash_surfels(hash, scene.surfels);
    for (const SceneBlock& block : scene.blocks) hash_surfels(hash, load_block(block));
    return {"scene", "the scene", hash.hex_digest()};
}

std::map<std::string, std::string> make_resume_texts(const std::vector<ConfigKey>& settings,
                                                     const std::vector<ResumeFingerprint>& fingerprints) {
    std::map<std::string, std::string> texts;
    for (const ConfigKey& setting : settings) texts[kSettingPrefix + setting.key] = setting.value;
    for (const ResumeFingerprint& fingerprint : fingerprints) texts[fingerprint.key] = fingerprint.value;
    return texts;
}

void check_settings(const std::vector<ConfigKey>& settings, const Checkpoint& checkpoint,
                    const std::string& prefix) {
    const std::map<std::string, std::string> saved = read_settings(checkpoint);
    for (const ConfigKey& setting : settings) {
        const auto it = saved.find(setting.key);
        if (it == saved.end())
            fail("{}: the checkpoint has no value for the setting {}; {}", prefix, setting.key,
                 kTrainAgainAdvice);
        if (it->second != setting.value)
            fail<UsageError>("{}: setting {}: found {}, expected {} as in the checkpoint", prefix,
                             setting.key, setting.value, it->second);
    }
}

void check_fingerprints(const std::vector<ResumeFingerprint>& fingerprints, const Checkpoint& checkpoint,
                        const std::string& prefix) {
    for (const ResumeFingerprint& now : fingerprints) {
        const auto it = checkpoint.texts.find(now.key);
        const std::string saved = it == checkpoint.texts.end() ? "nothing" : it->second;
        if (saved != now.value)
            fail("{}: {}: found {}, expected {} as in the checkpoint", prefix, now.what, now.value, saved);
    }
}

std::map<std::string, std::string> read_settings(const Checkpoint& checkpoint) {
    const std::string prefix = kSettingPrefix;
    std::set<std::string> setting_keys;
    for (const ConfigKey& key : list_config_keys(Config{})) setting_keys.insert(key.key);
    std::map<std::string, std::string> settings;
    for (const auto& [text, value] : checkpoint.texts) {
        if (!text.starts_with(prefix)) continue;
        const std::string key = text.substr(prefix.size());
        if (!setting_keys.contains(key))
            fail("the checkpoint of iteration {} has the unknown setting {}; {}", checkpoint.iteration,
                 quote(key), kTrainAgainAdvice);
        settings.emplace(key, value);
    }
    return settings;
}

/// Starts to compute the texts of all checkpoints in another thread.
CheckpointFolder::CheckpointFolder(Options options) : options_(std::move(options)) {
    if (is_enabled()) texts_ = std::async(std::launch::async, options_.make_texts);
}

bool CheckpointFolder::is_time_due() const {
    const std::chrono::duration<double> since_last = Clock::now() - last_;
    return options_.minutes > 0.0 && since_last.count() >= 60.0 * options_.minutes;
}

void CheckpointFolder::save(int iteration, const std::function<void(Checkpoint&)>& add_state) {
    // Sets the time before writing. If writing fails because the disk is full, the next
    // attempt then happens after one interval, not in the next step.
    last_ = Clock::now();
    Checkpoint checkpoint{iteration, texts_.get(), {}};
    const std::string& noun = options_.iteration_noun;
    const auto report_failure = [&](const std::string& cause) {
        const std::string earlier =
            newest_iteration() > 0
                ? fmt::format("the last checkpoint was written at {} {}", noun, newest_iteration())
                : "no earlier checkpoint has been written";
        if (options_.report_note)
            options_.report_note(fmt::format("cannot write the checkpoint at {} {} ({}): {}", noun, iteration,
                                             earlier, cause));
    };
    try {
        add_state(checkpoint);
    } catch (const std::bad_alloc&) {
        report_failure("not enough memory");
        return;
    }
    try {
        check_finite_arrays(checkpoint);
    } catch (const DataError& error) {
        fail("training failed at {} {}: {}", noun, iteration, error.what());
    }
    try {
        save_checkpoint(options_.folder, checkpoint, kMaxCheckpoints);
        options_.newest_iteration = iteration;
    } catch (const DataError& error) {
        report_failure(error.what());
    }
}

/// Each checkpoint contains the settings and hashes that check_resume() compares. They
/// are computed by make_texts(), which refers to the arguments.
CheckpointKeeper::CheckpointKeeper(const Log& log, const Split& split, const Config& config,
                                   const TrainSession& session)
    : config_(config.train),
      folder_({.folder = session.checkpoints,
               .newest_iteration = session.start ? session.start->iteration : 0,
               .iteration_noun = "iteration",
               .minutes = config.train.checkpoint_minutes,
               .report_note = session.note,
               .make_texts = [&log, &split, &config] {
                   return make_resume_texts(list_config_keys(config), fingerprint_log(log, split));
               }}) {}

bool CheckpointKeeper::is_due(int step) const {
    if (!folder_.is_enabled()) return false;
    const bool by_count = config_.checkpoint_every > 0 && step % config_.checkpoint_every == 0;
    // A training that was too short for a checkpoint also gets none at its end.
    const bool is_last = step == config_.iterations && folder_.newest_iteration() > 0;
    return by_count || folder_.is_time_due() || is_last;
}

void CheckpointKeeper::save_state(const std::function<void(Checkpoint&)>& add_state,
                                  const TrainResult& result, double training_time_s) {
    if (!folder_.is_enabled()) return;
    folder_.save(result.iterations, [&](Checkpoint& checkpoint) {
        CheckpointWriter write(checkpoint);
        add_state(checkpoint);
        write_log(write, result, training_time_s);
    });
}

std::string find_fixed_setting(const Config& config, const Config& other_config) {
    const std::vector<ConfigKey> a = list_config_keys(config), b = list_config_keys(other_config);
    for (std::size_t i = 0; i < a.size(); ++i)
        if (!is_resume_free(a[i].key) && a[i].value != b[i].value) return a[i].key;
    return "";
}

void check_resume(const Checkpoint& checkpoint, const Log& log, const Split& split, const Config& config) {
    const std::string doing = fmt::format("cannot resume from iteration {}", checkpoint.iteration);
    std::vector<ConfigKey> settings = list_config_keys(config);
    // Settings that do not change the result of an iteration may differ.
    std::erase_if(settings, [](const ConfigKey& key) { return is_resume_free(key.key); });
    check_settings(settings, checkpoint, doing);
    if (config.train.iterations < checkpoint.iteration)
        fail<UsageError>(
            "{}: setting train.iterations: found {}, expected at least the iteration of the checkpoint",
            doing, config.train.iterations);
    check_fingerprints(fingerprint_log(log, split), checkpoint, doing);
}

void append_log_line(std::vector<TrainProgress>& log, const TrainLogLine& line, const Config& config,
                     double elapsed_s) {
    TrainProgress progress = make_progress(line.step, config, elapsed_s, line.terms, line.n_surfels);
    progress.densified = line.densified;
    const int n_left = progress.n_iterations - progress.iteration;
    const int n_since_first_line = log.empty() ? 0 : progress.iteration - log.front().iteration;
    if (n_left == 0) progress.eta_s = 0.0;
    else if (n_since_first_line == 0) progress.eta_s = std::numeric_limits<double>::infinity();
    else progress.eta_s = n_left * (progress.seconds - log.front().seconds) / n_since_first_line;
    log.push_back(std::move(progress));
}

void write_log(CheckpointWriter& writer, const TrainResult& result, double training_time_s) {
    LogColumns columns;
    for (const TrainProgress& line : result.log) {
        columns.iteration.push_back(line.iteration);
        columns.seconds.push_back(line.seconds);
        columns.surfels.push_back(line.n_surfels);
        for (std::size_t k = 0; k < line.terms.size(); ++k) columns.terms[k].push_back(line.terms[k]);
        for (std::size_t k = 0; k < kDensifyCounts.size(); ++k)
            columns.densified[k].push_back(densify_count(line.densified, k));
    }
    columns.visit_state(writer);
    writer("initialise_s", result.initialise_s);
    writer("train_s", training_time_s);
}

std::vector<TrainProgress> read_training_log(const Checkpoint& checkpoint, const Config& config) {
    LogColumns columns;
    columns.visit_state(CheckpointReader(checkpoint));
    if (!columns.have_equal_lengths())
        fail(
            "cannot resume from iteration {}: the columns of log.jsonl in the checkpoint have different "
            "lengths; train again",
            checkpoint.iteration);
    std::vector<TrainProgress> lines;
    for (std::size_t i = 0; i < columns.iteration.size(); ++i) {
        std::array<double, kLossTerms> terms{};
        for (std::size_t k = 0; k < terms.size(); ++k) terms[k] = columns.terms[k][i];
        TrainProgress line =
            make_progress(columns.iteration[i], config, columns.seconds[i], terms, columns.surfels[i]);
        for (std::size_t k = 0; k < kDensifyCounts.size(); ++k)
            densify_count(line.densified, k) = columns.densified[k][i];
        lines.push_back(line);
    }
    return lines;
}

void read_log(const Checkpoint& checkpoint, const Config& config, TrainResult& result) {
    const CheckpointReader read(checkpoint);
    result.log = read_training_log(checkpoint, config);
    result.iterations = checkpoint.iteration;
    read("initialise_s", result.initialise_s);
    read("train_s", result.train_s);
}

Scene read_scene(const Checkpoint& checkpoint) {
    Scene scene;
    scene.surfels = CheckpointReader(checkpoint).read_surfels("parameters");
    parse_layout(checkpoint.text("layout"),
                 fmt::format("checkpoint of iteration {}: layout", checkpoint.iteration), scene);
    return scene;
}

}  // namespace relidar
