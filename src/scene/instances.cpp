// SPDX-License-Identifier: Apache-2.0
// Instances of a scene: found by name, and given models of their own.
#include <relidar/scene.hpp>

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/error.hpp>

namespace relidar {

Scene own_models(Scene scene) {
    std::vector<bool> owned(scene.models.size(), false);
    for (Instance& instance : scene.instances) {
        const Model model = scene.models[instance.model];
        if (!owned[instance.model]) {
            owned[instance.model] = true;
            continue;
        }
        instance.model = static_cast<std::uint32_t>(scene.models.size());
        scene.models.push_back(model);   // with its box
        scene.models.back().first = static_cast<std::uint32_t>(scene.surfels.size());
        scene.surfels.append(scene.surfels.slice(model.first, model.count));
        owned.push_back(true);
    }
    return scene;
}

std::vector<bool> select_instances(const Scene& scene, const std::vector<std::string>& names) {
    std::vector<bool> selected(scene.instances.size(), false);
    std::vector<std::string> known{"background", "actors"};
    for (const Instance& instance : scene.instances)
        if (!instance.track.empty()) known.push_back(instance.track);
    for (const std::string& name : names) {
        if (std::find(known.begin(), known.end(), name) == known.end())
            throw UsageError(fmt::format("choosing instances: found \"{}\"{} (there are: {})", name,
                                         did_you_mean(name, known, "\""), fmt::join(known, ", ")));
        for (std::size_t i = 0; i < selected.size(); ++i) {
            const std::string& track = scene.instances[i].track;
            if (track.empty() ? name == "background" : name == "actors" || name == track) selected[i] = true;
        }
    }
    return selected;
}

}  // namespace relidar
