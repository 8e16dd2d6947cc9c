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

constexpr const char* kSetting = "setting/";
constexpr const char* kTrainAgain =
    "the checkpoint was probably written by another version of relidar and cannot be resumed; train again";

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
            state_ = hash_integer_pair(state_, word);
        }
        state_ = hash_integer_pair(state_, n_bytes);
    }
    std::string get_hex_digest() const { return fmt::format("{:016x}", state_); }

private:
    std::uint64_t state_ = 0;
};

std::string format_frame_selection_with_hash(const LidarSequence& sequence,
                                             const std::vector<int>& frame_indices) {
    std::vector<int> indices;
    for (const int position : frame_indices) indices.push_back(sequence.frames[std::size_t(position)].index);
    RunningHash hash;
    hash.add_to_hash(indices);
    return fmt::format("{} frames from {} to {} ({})", indices.size(), indices.empty() ? -1 : indices.front(),
                       indices.empty() ? -1 : indices.back(), hash.get_hex_digest());
}

std::string hash_scans(const LidarSequence& sequence, const std::vector<int>& frame_indices) {
    RunningHash hash;
    for (const int position : frame_indices) {
        const Scan& scan = sequence.frames[std::size_t(position)].scan;
        hash.add_to_hash(scan.rays.direction);
        hash.add_to_hash(scan.range_m);
        hash.add_to_hash(scan.intensity);
    }
    return hash.get_hex_digest();
}

std::string hash_boxes(const LidarSequence& sequence) {
    RunningHash hash;
    for (const BoxTrack& box : sequence.boxes) {
        hash.add_to_hash(box.id);
        hash.add_to_hash(box.category);
        hash.add_to_hash(&box.size_m, sizeof box.size_m);
        hash.add_to_hash(box.world_from_box);
    }
    return hash.get_hex_digest();
}

std::string hash_poses(const LidarSequence& sequence) {
    RunningHash hash;
    hash.add_to_hash(sequence.world_from_vehicle);
    return hash.get_hex_digest();
}

void add_surfels_to_hash(RunningHash& hash, const Surfels& surfels) {
    if (surfels.size() == 0) return;
    for (const SurfelParameterGroup& group : list_parameter_groups(surfels.get_parameter_set())) {
        const std::span<const float> values = group.values(surfels);
        hash.add_to_hash(values.data(), values.size_bytes());
    }
}

constexpr const char* kMismatch = "{}: {}: found {}, expected {} as in the checkpoint";

}  // namespace

std::vector<ResumeFingerprint> compute_log_fingerprints(const LidarSequence& sequence,
                                                        const TrainTestSplit& split) {
    return {{"log/training frames", "the log's training frames",
             format_frame_selection_with_hash(sequence, split.train)},
            {"log/scans", "the log's scans", hash_scans(sequence, split.train)},
            {"log/sensor poses", "the log's sensor poses", hash_poses(sequence)},
            {"log/boxes", "the log's boxes", hash_boxes(sequence)}};
}

ResumeFingerprint compute_scene_fingerprint(const Scene& scene) {
    RunningHash hash;
    hash.add_to_hash(format_scene_layout_json(scene));
    hash.add_to_hash(scene.sensor_drop.probability);
    add_surfels_to_hash(hash, scene.surfels);
    for (const SceneBlock& block : scene.blocks) add_surfels_to_hash(hash, load_block_surfels(block));
    return {"scene", "the scene", hash.get_hex_digest()};
}

std::map<std::string, std::string> make_resume_texts(const std::vector<ConfigKey>& settings,
                                                     const std::vector<ResumeFingerprint>& fingerprints) {
    std::map<std::string, std::string> texts;
    for (const ConfigKey& setting : settings) texts[kSetting + setting.key] = setting.value;
    for (const ResumeFingerprint& fingerprint : fingerprints) texts[fingerprint.key] = fingerprint.value;
    return texts;
}

void require_same_as_in_checkpoint(const std::vector<ConfigKey>& settings, const Checkpoint& checkpoint,
                                   const std::string& error_prefix) {
    const std::map<std::string, std::string> saved = read_checkpoint_settings(checkpoint);
    for (const ConfigKey& setting : settings) {
        const auto it = saved.find(setting.key);
        if (it == saved.end())
            fail("{}: the checkpoint has no value for the setting {}; {}", error_prefix, setting.key,
                 kTrainAgain);
        if (it->second != setting.value)
            fail<UsageError>(kMismatch, error_prefix, "setting " + setting.key, setting.value, it->second);
    }
}

void require_same_as_in_checkpoint(const Checkpoint& checkpoint, const ResumeFingerprint& fingerprint,
                                   const std::string& error_prefix) {
    const auto it = checkpoint.texts.find(fingerprint.key);
    const std::string saved = it == checkpoint.texts.end() ? "nothing" : it->second;
    if (saved != fingerprint.value) fail(kMismatch, error_prefix, fingerprint.what, fingerprint.value, saved);
}

std::map<std::string, std::string> read_checkpoint_settings(const Checkpoint& checkpoint) {
    const std::string prefix = kSetting;
    std::set<std::string> setting_keys;
    for (const ConfigKey& key : list_config_keys(Config{})) setting_keys.insert(key.key);
    std::map<std::string, std::string> settings;
    for (const auto& [text, value] : checkpoint.texts) {
        if (!text.starts_with(prefix)) continue;
        const std::string key = text.substr(prefix.size());
        if (!setting_keys.contains(key))
            fail("the checkpoint of iteration {} has the unknown setting {}; {}", checkpoint.iteration,
                 shorten_for_error_message(key), kTrainAgain);
        settings.emplace(key, value);
    }
    return settings;
}

}  // namespace relidar
