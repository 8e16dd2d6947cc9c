// SPDX-License-Identifier: Apache-2.0
// Computes hashes of logs and scenes, and compares them with the hashes in a checkpoint.
#include "train/checkpoints/fingerprint.hpp"

#include <cstring>
#include <set>
#include <span>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>

#include "base/files.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

constexpr const char* kSetting = "setting/";
constexpr const char* kTrainAgain =
    "a checkpoint that another version of relidar has written cannot be resumed; train again";

/// Computes a hash of all added values. The order of the values matters.
class Hash {
public:
    template <class T, class Allocator>
    void add(const std::vector<T, Allocator>& values) {
        add(values.data(), values.size() * sizeof(T));
    }
    void add(const std::string& text) { add(text.data(), text.size()); }
    void add(const PoseTrack& track) {
        add(track.time_s);
        for (const Pose& pose : track.pose)
            add(&pose.rotation, sizeof pose.rotation), add(&pose.translation, sizeof pose.translation);
    }
    void add(const void* bytes, std::size_t count) {
        for (std::size_t i = 0; i < count; i += 8) {
            std::uint64_t word = 0;
            std::memcpy(&word, static_cast<const std::byte*>(bytes) + i, std::min<std::size_t>(8, count - i));
            state_ = combine_hashes(state_, word);
        }
        state_ = combine_hashes(state_, count);
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

void add(Hash& hash, const Surfels& surfels) {
    if (surfels.size() == 0) return;
    for (const ParameterGroup& group : list_parameter_groups(surfels.parameters())) {
        const std::span<const float> values = group.values(surfels);
        hash.add(values.data(), values.size_bytes());
    }
}

std::string hash_scene(const Scene& scene) {
    Hash hash;
    hash.add(layout_to_json(scene));
    hash.add(scene.sensor_drop.probability);
    add(hash, scene.surfels);
    for (const SceneBlock& block : scene.blocks) add(hash, read_block(block));
    return hash.hex();
}

std::string read_fingerprint(const Checkpoint& checkpoint, const std::string& key) {
    const auto it = checkpoint.texts.find(key);
    return it == checkpoint.texts.end() ? "nothing" : it->second;
}

std::string describe_difference(const std::string& action, const std::string& description,
                                const std::string& found_value, const std::string& expected) {
    return fmt::format("{}: {}: found {}, expected {} as in the checkpoint", action, description, found_value,
                       expected);
}

}  // namespace

std::vector<Mark> list_marks(const Sequence& sequence, const Split& split) {
    return {{"log/training frames", "the log's training frames", describe_frames(sequence, split.train)},
            {"log/scans", "the log's scans", hash_scans(sequence, split.train)},
            {"log/sensor poses", "the log's sensor poses", hash_poses(sequence)},
            {"log/boxes", "the log's boxes", hash_boxes(sequence)}};
}

Mark hash_scene_surfels(const Scene& scene) { return {"scene", "the scene", hash_scene(scene)}; }

void add_checkpoint_text(const ConfigKey& setting, std::map<std::string, std::string>& texts) {
    texts[kSetting + setting.key] = setting.value;
}
void add_checkpoint_text(const Mark& mark, std::map<std::string, std::string>& texts) {
    texts[mark.key] = mark.value;
}

void check_same(const std::vector<ConfigKey>& settings, const Checkpoint& checkpoint,
                const std::string& action) {
    const std::map<std::string, std::string> saved = read_settings(checkpoint);
    for (const ConfigKey& setting : settings) {
        const auto it = saved.find(setting.key);
        if (it == saved.end())
            throw DataError(fmt::format("{}: the checkpoint has no value for the setting {}; {}", action,
                                        setting.key, kTrainAgain));
        if (it->second != setting.value)
            throw UsageError(
                describe_difference(action, "setting " + setting.key, setting.value, it->second));
    }
}

void check_same(const Checkpoint& checkpoint, const Mark& mark, const std::string& action) {
    const std::string saved = read_fingerprint(checkpoint, mark.key);
    if (saved != mark.value) throw DataError(describe_difference(action, mark.what, mark.value, saved));
}

std::map<std::string, std::string> read_settings(const Checkpoint& checkpoint) {
    const std::string prefix = kSetting;
    std::set<std::string> known;
    for (const ConfigKey& key : list_config_keys(Config{})) known.insert(key.key);
    std::map<std::string, std::string> settings;
    for (const auto& [text, value] : checkpoint.texts) {
        if (!text.starts_with(prefix)) continue;
        const std::string key = text.substr(prefix.size());
        if (!known.contains(key))
            throw DataError(fmt::format("the checkpoint of iteration {} has the unknown setting {}; {}",
                                        checkpoint.iteration, make_excerpt(key), kTrainAgain));
        settings.emplace(key, value);
    }
    return settings;
}

}  // namespace relidar
