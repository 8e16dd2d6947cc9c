// SPDX-License-Identifier: Apache-2.0
// Finds instances by name. Copies models so that no two instances share a model.
#include <relidar/scene/scene.hpp>

#include <fmt/ranges.h>

#include "base/fail.hpp"

namespace relidar {

std::uint32_t append_model(Scene& scene, const Scene& source_scene, std::uint32_t model) {
    SurfelModel added = source_scene.models[model];  // copies the box size and the stride too
    const Surfels surfels = source_scene.surfels.slice(added.first, added.count);
    added.first = static_cast<std::uint32_t>(scene.surfels.size());
    scene.models.push_back(std::move(added));
    scene.surfels.append_surfels(surfels);
    return static_cast<std::uint32_t>(scene.models.size() - 1);
}

Scene unshare_models(Scene scene) {
    std::vector<bool> owned(scene.models.size(), false);
    for (ModelInstance& instance : scene.instances) {
        // The first instance keeps the model. Each further instance gets a copy.
        if (!owned[instance.model]) {
            owned[instance.model] = true;
            continue;
        }
        instance.model = append_model(scene, scene, instance.model);
        owned.push_back(true);
    }
    return scene;
}

std::vector<bool> select_instances(const Scene& scene, const std::vector<std::string>& instance_names) {
    std::vector<bool> selected(scene.instances.size(), false);
    std::vector<std::string> part_names{"background", "actors"};
    for (const ModelInstance& instance : scene.instances)
        if (!instance.track.empty()) part_names.push_back(instance.track);
    for (const std::string& name : instance_names) {
        if (std::find(part_names.begin(), part_names.end(), name) == part_names.end())
            fail<UsageError>("cannot select the part \"{}\" of the scene{} (known parts: {})", name,
                             did_you_mean(name, part_names, "\""), fmt::join(part_names, ", "));
        for (std::size_t i = 0; i < selected.size(); ++i) {
            const std::string& track = scene.instances[i].track;
            // Only the background has no track.
            if (track.empty() ? name == "background" : name == "actors" || name == track) selected[i] = true;
        }
    }
    return selected;
}

}  // namespace relidar
