// SPDX-License-Identifier: Apache-2.0
#include "scene_source.hpp"

#include <algorithm>

#include <relidar/run/run.hpp>
#include "base/fail.hpp"

namespace relidar::serve {
namespace {

namespace fs = std::filesystem;

std::string last_component(const std::string& folder_path) {
    const fs::path path = fs::absolute(folder_path).lexically_normal();
    return path.has_filename() ? path.filename().string() : path.parent_path().filename().string();
}

}  // namespace

Run SceneSource::load() const {
    Run run = load_run(folder);
    if (channels) set_value(run.config, "render.channels", *channels);
    return run;
}

/// Parses command line arguments of the form RUN or NAME=RUN. Without a name, the scene
/// has the name of its folder. A path that contains '=' is RUN if it exists.
std::vector<SceneSource> parse_sources(const std::vector<std::string>& arguments,
                                       const std::optional<std::string>& channels, const Weather& weather) {
    std::vector<SceneSource> sources;
    for (const std::string& word : arguments) {
        const std::size_t equals = word.find('=');
        const bool has_name = equals != std::string::npos && !fs::exists(word);
        const std::string folder = has_name ? word.substr(equals + 1) : word;
        const std::string name = has_name ? word.substr(0, equals) : last_component(folder);
        if (name.empty()) fail<UsageError>("cannot serve {}: it has no name, expected NAME=RUN", word);
        const auto same = std::ranges::find(sources, name, &SceneSource::name);
        if (same != sources.end())
            fail<UsageError>("cannot serve {} and {}: both have the name \"{}\"; use NAME=RUN",
                             same->folder.string(), folder, name);
        sources.push_back({name, folder, channels, weather});
    }
    return sources;
}

}  // namespace relidar::serve
