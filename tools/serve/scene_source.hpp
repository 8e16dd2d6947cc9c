// SPDX-License-Identifier: Apache-2.0
// Which runs are served, and what clients call them by.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace relidar::serve {

/// A run to be served, and the name that clients call it by.
struct SceneSource {
    std::string name;
    std::filesystem::path folder;
};

/// From words "RUN" or "NAME=RUN"; the name is the folder's where none is given. @throws UsageError for a name that is used twice
std::vector<SceneSource> scene_sources(const std::vector<std::string>& words);

}  // namespace relidar::serve
