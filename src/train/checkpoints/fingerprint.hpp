// SPDX-License-Identifier: Apache-2.0
// What a checkpoint says of the training it belongs to, and whether it is the same one:
// settings by value, logs and scenes by hashes. Private to train.
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

/// Something that must be as it was: its name in a checkpoint, what messages call it, and
/// what it is now.
struct Mark {
    std::string key, what, value;
};

/// Of a log with the scans of its training frames, in the order in which a difference is
/// explained best.
std::vector<Mark> marks_of(const Sequence& sequence, const Split& split);
/// Of every surfel of a scene, those of its blocks too. @throws DataError as read_block()
Mark mark_of(const Scene& scene);

/// Puts them among the texts of a checkpoint.
void put(const ConfigKey& setting, std::map<std::string, std::string>& texts);
void put(const Mark& mark, std::map<std::string, std::string>& texts);
/// @param doing  how the message begins
/// @throws UsageError for a setting with another value, DataError for a missing setting
/// or another mark
void check_same(const std::vector<ConfigKey>& settings, const Checkpoint& checkpoint,
                const std::string& doing);
void check_same(const Checkpoint& checkpoint, const Mark& mark, const std::string& doing);
/// The settings that were put into it, by key. @throws DataError for an unknown key
std::map<std::string, std::string> settings_in(const Checkpoint& checkpoint);

}  // namespace relidar
