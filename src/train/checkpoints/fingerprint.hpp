// SPDX-License-Identifier: Apache-2.0
// Stores in a checkpoint what the training depends on: the values of the settings, and
// hashes of the log and the scene. A resumed training compares them with its own, to
// check that the checkpoint belongs to the same training. Private to train.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// A property that must not change when training is resumed: its key in a checkpoint, its
/// name in messages, and its current value.
struct ResumeFingerprint {
    std::string key, what, value;
};

/// The hash that explains a difference best comes first, because only one is reported.
std::vector<ResumeFingerprint> fingerprint_log(const Log& sequence, const Split& split);
ResumeFingerprint fingerprint_scene(const Scene& scene);

std::map<std::string, std::string> make_resume_texts(const std::vector<ConfigKey>& settings,
                                                     const std::vector<ResumeFingerprint>& fingerprints);
/// Compares settings or a hash with the values in a checkpoint.
/// @param prefix  start of the error message
/// @throws UsageError if a setting has another value
/// @throws DataError if a setting is missing or a hash differs
void check_same(const std::vector<ConfigKey>& keys, const Checkpoint& checkpoint, const std::string& prefix);
void check_same(const Checkpoint& checkpoint, const ResumeFingerprint& mark, const std::string& prefix);
/// @throws DataError for an unknown key
std::map<std::string, std::string> read_settings(const Checkpoint& checkpoint);

}  // namespace relidar
