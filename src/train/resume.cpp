// SPDX-License-Identifier: Apache-2.0
// What must be equal where training continues (settings, and the log by hashes), and the log and times so far.
#include "train/resume.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <optional>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/run.hpp>

#include "core/files.hpp"
#include "core/random.hpp"

namespace relidar {
namespace {

constexpr const char* kSetting = "setting/";
constexpr const char* kLog = "log/";

/// Settings that change where training ends, what it reports, or where the log lies, but not a step of it. Paths are free because the log
/// itself is compared.
constexpr std::string_view kFollows = "refine.";   // and these, of what begins where the steps end
constexpr std::array kFree{"preset",
                           "dataset.path",
                           "dataset.sequence",
                           "dataset.poses",
                           "dataset.memory_mib",
                           "train.frame_memory_mib",
                           "train.iterations",
                           "train.place_held_out",
                           "train.log_every",
                           "train.checkpoint_every",
                           "train.checkpoint_minutes",
                           "train.checkpoint_keep",
                           "render.range",
                           "sensor.grid",
                           "sensor.grid_method",
                           "trace.chunk",
                           "trace.proxy"};

/// Hash of everything added, in order.
class Hash {
public:
    template <class T, class Allocator>
    void add(const std::vector<T, Allocator>& values) { add(values.data(), values.size() * sizeof(T)); }
    void add(const std::string& text) { add(text.data(), text.size()); }
    void add(const PoseTrack& track) {
        add(track.time_s);
        for (const Pose& pose : track.pose) add(&pose.rotation, sizeof pose.rotation), add(&pose.translation, sizeof pose.translation);
    }
    void add(const void* bytes, std::size_t n) {
        for (std::size_t i = 0; i < n; i += 8) {
            std::uint64_t word = 0;
            std::memcpy(&word, static_cast<const std::byte*>(bytes) + i, std::min<std::size_t>(8, n - i));
            state_ = hash64(state_, word);
        }
        state_ = hash64(state_, n);
    }
    std::string hex() const { return fmt::format("{:016x}", state_); }

private:
    std::uint64_t state_ = 0;
};

std::string describe_frames(const Sequence& sequence, const std::vector<int>& positions) {
    std::vector<int> indices;
    for (const int position : positions) indices.push_back(sequence.frames[std::size_t(position)].index);
    Hash hash;
    hash.add(indices);
    return fmt::format("{} frames from {} to {} ({})", indices.size(), indices.empty() ? -1 : indices.front(),
                       indices.empty() ? -1 : indices.back(), hash.hex());
}

std::string hash_scans(const Sequence& sequence, const std::vector<int>& positions) {
    Hash hash;
    for (const int position : positions) {
        const Scan& scan = sequence.frames[std::size_t(position)].scan;
        hash.add(scan.rays.direction);
        hash.add(scan.range_m);
        hash.add(scan.intensity);
    }
    return hash.hex();
}

std::string hash_boxes(const Sequence& sequence) {
    Hash hash;
    for (const BoxTrack& box : sequence.boxes) {
        hash.add(box.id);
        hash.add(box.category);
        hash.add(&box.size_m, sizeof box.size_m);
        hash.add(box.world_from_box);
    }
    return hash.hex();
}

std::string hash_poses(const Sequence& sequence) {
    Hash hash;
    hash.add(sequence.world_from_vehicle);
    return hash.hex();
}

/// In the order in which a difference is explained best.
std::vector<std::pair<std::string, std::string>> log_texts(const Sequence& sequence, const Split& split) {
    return {{"training frames", describe_frames(sequence, split.train)},
            {"scans", hash_scans(sequence, split.train)},
            {"sensor poses", hash_poses(sequence)},
            {"boxes", hash_boxes(sequence)}};
}

std::string found_in(const Checkpoint& checkpoint, const std::string& key) {
    const auto it = checkpoint.texts.find(key);
    return it == checkpoint.texts.end() ? "nothing" : it->second;
}

/// The log so far, column by column.
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
        for (std::size_t k = 0; k < terms.size(); ++k) visit(std::string("log/") + kLossTermNames[k], terms[k]);
        for (std::size_t k = 0; k < densified.size(); ++k) visit(std::string("log/densified/") + kDensifyCounts[k].first, densified[k]);
    }
};

/// Earlier versions wrote 8 where this one writes 8.0.
bool same_value(const std::string& a, const std::string& b) {
    const std::optional<double> x = parse_number(a), y = parse_number(b);
    return x && y ? *x == *y : a == b;
}

}  // namespace

std::map<std::string, std::string> training_texts(const Sequence& sequence, const Split& split, const Config& config) {
    std::map<std::string, std::string> texts;
    for (const ConfigKey& key : config_keys(config)) texts[kSetting + key.key] = key.value;
    for (const auto& [name, value] : log_texts(sequence, split)) texts[kLog + name] = value;
    return texts;
}

void check_resumable(const Checkpoint& checkpoint, const Sequence& sequence, const Split& split, const Config& config) {
    const auto differs = [&](const std::string& what, const std::string& found, const std::string& expected) {
        return fmt::format("resuming from iteration {}: {}: found {}, expected {} as in the checkpoint", checkpoint.iteration, what, found,
                           expected);
    };
    for (const ConfigKey& key : config_keys(config)) {
        const std::string saved = found_in(checkpoint, kSetting + key.key);
        const bool is_free = std::find(kFree.begin(), kFree.end(), key.key) != kFree.end() || key.key.starts_with(kFollows);
        if (!is_free && !same_value(saved, key.value)) throw UsageError(differs("setting " + key.key, key.value, saved));
    }
    if (config.train.iterations < checkpoint.iteration)
        throw UsageError(fmt::format("resuming from iteration {}: setting train.iterations: found {}, expected at least as many",
                                     checkpoint.iteration, config.train.iterations));
    for (const auto& [name, value] : log_texts(sequence, split)) {
        const std::string saved = found_in(checkpoint, kLog + name);
        if (saved != value) throw DataError(differs("the log's " + name, value, saved));
    }
}

TrainProgress progress_at(int step, const Config& config, double seconds, const std::array<double, kLossTerms>& terms,
                          std::uint32_t n_surfels) {
    TrainProgress p;
    p.iteration = step;
    p.n_iterations = config.train.iterations;
    p.seconds = seconds;
    p.iterations_per_second = step / std::max(seconds, 1e-9);
    p.eta_s = (config.train.iterations - step) / std::max(p.iterations_per_second, 1e-9);
    p.terms = terms;
    p.loss = std::accumulate(terms.begin(), terms.end(), 0.0);
    p.n_surfels = n_surfels;
    return p;
}

void write_result(StateWriter& write, const TrainResult& result, double train_s) {
    LogColumns log;
    for (const TrainProgress& p : result.log) {
        log.iteration.push_back(p.iteration);
        log.seconds.push_back(p.seconds);
        log.surfels.push_back(p.n_surfels);
        for (std::size_t k = 0; k < p.terms.size(); ++k) log.terms[k].push_back(p.terms[k]);
        for (std::size_t k = 0; k < kDensifyCounts.size(); ++k) log.densified[k].push_back(p.densified.*kDensifyCounts[k].second);
    }
    log.visit_state(write);
    write("initialise_s", result.initialise_s);
    write("train_s", train_s);
}

std::vector<TrainProgress> resumed_log(const Checkpoint& checkpoint, const Config& config) {
    LogColumns log;
    log.visit_state(StateReader(checkpoint));
    const std::size_t n = log.iteration.size();
    const auto as_long = [n](const auto& column) { return column.size() == n; };
    const bool even = as_long(log.seconds) && as_long(log.surfels) && std::ranges::all_of(log.terms, as_long) &&
                      std::ranges::all_of(log.densified, as_long);
    if (!even) throw DataError(fmt::format("resuming from iteration {}: the columns of the log differ in length", checkpoint.iteration));
    std::vector<TrainProgress> lines;
    for (std::size_t i = 0; i < n; ++i) {
        std::array<double, kLossTerms> terms{};
        for (std::size_t k = 0; k < terms.size(); ++k) terms[k] = log.terms[k][i];
        lines.push_back(progress_at(log.iteration[i], config, log.seconds[i], terms, log.surfels[i]));
        for (std::size_t k = 0; k < kDensifyCounts.size(); ++k) lines.back().densified.*kDensifyCounts[k].second = log.densified[k][i];
    }
    return lines;
}

void read_result(const Checkpoint& checkpoint, const Config& config, TrainResult& result) {
    const StateReader read(checkpoint);
    result.log = resumed_log(checkpoint, config);
    result.iterations = checkpoint.iteration;
    read("initialise_s", result.initialise_s);
    read("train_s", result.train_s);
}

Scene scene_of(const Checkpoint& checkpoint) {
    Scene scene;
    scene.surfels = StateReader(checkpoint).surfels("parameters");
    read_layout_json(checkpoint.text("layout"), fmt::format("checkpoint of iteration {}: layout", checkpoint.iteration), scene);
    return scene;
}

}  // namespace relidar
