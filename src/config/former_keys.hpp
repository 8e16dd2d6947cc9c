// SPDX-License-Identifier: Apache-2.0
// Settings of earlier versions, as config.toml of their runs and their checkpoints hold them. Private to config.
#pragma once

#include <span>
#include <string>

#include <relidar/config.hpp>

namespace relidar::config_detail {

/// A setting that is gone, and what it would have to be to say what the program does now.
struct RemovedKey {
    const char* key;
    /// Null: it changed nothing that is trained or rendered, any value will do.
    std::string (*now)(const Config& config, const std::string& found);
    const char* why;                            ///< a sentence's end: "it was removed: ..."
};

/// A setting that lives on in another one.
struct MovedKey {
    const char* key;
    const char* to;
    /// Takes a value over. @throws UsageError where there is no such value any more
    void (*take)(Config& config, const std::string& value);
};

/// A setting that was a constant of the code until some version: what a run of before was trained with.
struct AddedKey {
    const char* key;
    const char* before;
};
std::span<const AddedKey> added_keys();

/// @return null for another key
const RemovedKey* find_removed(const std::string& key);
const MovedKey* find_moved(const std::string& key);

/// @throws UsageError where a removed setting had another value than what stands for the program as it is
void check_removed(const Config& config, const RemovedKey& removed, const std::string& found);

}  // namespace relidar::config_detail
