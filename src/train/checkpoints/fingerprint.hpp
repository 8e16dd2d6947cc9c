// SPDX-License-Identifier: Apache-2.0
// Stores in a checkpoint what its training depends on: the values of the settings, and
// hashes of the log and the scene. These data show whether a checkpoint belongs to the
// same training. Private to train.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// Describes a property that must not change when training is resumed. Holds the key in a
/// checkpoint, the name in messages, and the current value.
struct Mark {
    std::string key, what, value;
};

/// Returns the hashes of a log and of the scans of its training frames. They are ordered
/// so that the first difference gives the best explanation.
std::vector<Mark> marks_of(const Sequence& sequence, const Split& split);
/// Returns a hash of all surfels of a scene, including its blocks.
/// @throws DataError like read_block()
Mark mark_of(const Scene& scene);

/// Stores a setting or a hash in the texts of a checkpoint.
void put(const ConfigKey& setting, std::map<std::string, std::string>& texts);
void put(const Mark& mark, std::map<std::string, std::string>& texts);
/// Compares settings or a hash with the values in a checkpoint.
/// @param doing  start of the error message
/// @throws UsageError for a setting with another value
/// @throws DataError for a missing setting or another hash
void check_same(const std::vector<ConfigKey>& settings, const Checkpoint& checkpoint,
                const std::string& doing);
void check_same(const Checkpoint& checkpoint, const Mark& mark, const std::string& doing);
/// Returns the settings in a checkpoint, by key.
/// @throws DataError for an unknown key
std::map<std::string, std::string> settings_in(const Checkpoint& checkpoint);

}  // namespace relidar
