// SPDX-License-Identifier: Apache-2.0
// Which runs are served, and what clients call them by.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/simulate/weather.hpp>

namespace relidar {
struct Run;
}

namespace relidar::serve {

/// A run to be served, and the name that clients call it by.
struct SceneSource {
    std::string name;
    std::filesystem::path folder;
    std::optional<std::string> channels = {};  ///< of its scans; none: as the run is configured
    Weather weather = {};                      ///< of its scans where a request does not say

    /// The run as it is served. @throws as load_run(); UsageError for unknown channels
    Run load() const;
};

/// From words "RUN" or "NAME=RUN"; the name is the folder's where none is given. @throws
/// UsageError for a name that is used twice
std::vector<SceneSource> scene_sources(const std::vector<std::string>& words,
                                       const std::optional<std::string>& channels = {},
                                       const Weather& weather = {});

}  // namespace relidar::serve
