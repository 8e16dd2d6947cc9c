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

struct SceneSource {
    std::string name;
    std::filesystem::path folder;
    std::optional<std::string> channels = {};
    Weather weather = {};  ///< Weather that is simulated if the request does not contain a weather.

    Run load() const;
};

/// "RUN" or "NAME=RUN". Without NAME: the name of the run's folder.
/// @throws UsageError if two scenes have the same name
std::vector<SceneSource> parse_sources(const std::vector<std::string>& arguments,
                                       const std::optional<std::string>& channels = {},
                                       const Weather& weather = {});

}  // namespace relidar::serve
