// SPDX-License-Identifier: Apache-2.0
#include "train/checkpoints/fingerprint.hpp"

#include <cstring>
#include <set>
#include <span>

#include <relidar/run/run.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/random.hpp"

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

std::string hash_frames(const Log& sequence, const std::vector<int>& frame_indices) {
    std::vector<int> indices;
    for (const int position : frame_indices) indices.push_back(sequence.frames[std::size_t(position)].index);
    RunningHash hash;
    hash.add_to_hash(indices);
    return fmt::format("{} frames from {} to {} ({})", indices.size(), indices.empty() ? -1 : indices.front(),
                       indices.empty() ? -1 : indices.back(), hash.hex_digest());
}

/// Returns a hash of the measurements of these frames.
std::string hash_scans(const Log& sequence, const std::vector<int>& frame_indices) {
    RunningHash hash;
    for (const int position : frame_indices) {
        const Scan& scan = sequence.frames[std::size_t(position)].scan;
        hash.add_to_hash(scan.rays.direction);
        hash.add_to_hash(scan.range_m);
        hash.add_to_hash(scan.intensity);
    }
    return hash.hex_digest();
}

/// Returns a hash of all labelled boxes with their poses.
std::string hash_boxes(const Log& sequence) {
    RunningHash hash;
    for (const BoxTrack& box : sequence.boxes) {
        hash.add_to_hash(box.id);
        hash.add_to_hash(box.category);
        hash.add_to_hash(&box.size_m, sizeof box.size_m);
        hash.add_to_hash(box.world_from_box);
    }
    return hash.hex_digest();
}

std::string hash_poses(const Log& sequence) {
    RunningHash hash;
    hash.add_to_hash(sequence.world_from_vehicle);
    return hash.hex_digest();
}

void hash_surfels(RunningHash& hash, const Surfels& surfels) {
    if (surfels.size() == 0) return;
    for (const SurfelParameterGroup& group : list_groups(surfels.parameters_used())) {
        const std::span<const float> values = group.values(surfels);
        hash.add_to_hash(values.data(), values.size_bytes());
    }
}

constexpr const char* kMismatch = "{}: {}: found {}, expected {} as in the checkpoint";

}  // namespace

std::vector<ResumeFingerprint> fingerprint_log(const Log& sequence, const Split& split) {
    return {{"log/training frames", "the log's training frames", hash_frames(sequence, split.train)},
            {"log/scans", "the log's scans", hash_scans(sequence, split.train)},
            {"log/sensor poses", "the log's sensor poses", hash_poses(sequence)},
            {"log/boxes", "the log's boxes", hash_boxes(sequence)}};
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

void check_same(const std::vector<ConfigKey>& keys, const Checkpoint& checkpoint, const std::string& prefix) {
    const std::map<std::string, std::string> saved = read_settings(checkpoint);
    for (const ConfigKey& setting : keys) {
        const auto it = saved.find(setting.key);
        if (it == saved.end())
            fail("{}: the checkpoint has no value for the setting {}; {}", prefix, setting.key,
                 kTrainAgainAdvice);
        if (it->second != setting.value)
            fail<UsageError>(kMismatch, prefix, "setting " + setting.key, setting.value, it->second);
    }
}

void check_same(const Checkpoint& checkpoint, const ResumeFingerprint& mark, const std::string& prefix) {
    const auto it = checkpoint.texts.find(mark.key);
    const std::string saved = it == checkpoint.texts.end() ? "nothing" : it->second;
    if (saved != mark.value) fail(kMismatch, prefix, mark.what, mark.value, saved);
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

}  // namespace relidar
