// SPDX-License-Identifier: Apache-2.0
// Maps the scene names that clients use to the runs of the server.
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

/// A run of the server, and its name for clients.
struct SceneSource {
    std::string name;
    std::filesystem::path folder;
    /// Channels of the rendered scans. Without a value, the settings of the run apply.
    std::optional<std::string> channels = {};
    Weather weather = {};  ///< Weather of a scan if the request does not set the weather.

    /// Loads the run and applies these settings.
    /// @throws the exceptions of load_run(); UsageError if a channel is unknown
    Run load() const;
};

/// Parses words of the form "RUN" or "NAME=RUN". Without a name, the name of the folder
/// is used.
/// @throws UsageError if two runs have the same name
std::vector<SceneSource> scene_sources(const std::vector<std::string>& words,
                                       const std::optional<std::string>& channels = {},
                                       const Weather& weather = {});

}  // namespace relidar::serve
