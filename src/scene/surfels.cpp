// SPDX-License-Identifier: Apache-2.0
// Surfels in host memory: resize, check, sort and concatenate.

#include <fmt/ranges.h>
#include <cmath>
#include <numeric>

#include <relidar/scene/device_scene.hpp>
#include <relidar/scene/labels.hpp>

#include "base/fail.hpp"
#include "base/geometry/ray_box.hpp"

namespace relidar {
namespace {

constexpr bool are_sorted() {
    for (std::size_t i = 0; i < kPrimitives.size(); ++i)
        if (kPrimitives[i].primitive != static_cast<PrimitiveType>(i)) return false;
    return true;
}
static_assert(are_sorted(), "kPrimitives must list the primitives in the order of PrimitiveType");

/// Returns true if surfels with this parameter set have the parameters of `group`.
bool has_group(SurfelParameterSet parameters, const SurfelParameterGroup& group) {
    switch (group.of) {
        case SurfelParameterGroup::SceneRequirement::third_scale:
            return properties_of(parameters.primitive).third_scale;
        case SurfelParameterGroup::SceneRequirement::bends: return parameters.bends;
        default: return true;
    }
}

}  // namespace

void Surfels::resize(std::size_t count, SurfelParameterSet parameters) {
    primitive = parameters.primitive;
    bends = parameters.bends;
    for (const SurfelParameterGroup& group : kParameterGroups)
        group.resize(*this, has_group(parameters, group) ? count * group.count_floats() : 0);
}

void Surfels::add_still_gait() {
    bends = true;
    gait.resize(size());
}

void Surfels::check_lengths() const {
    for (const SurfelParameterGroup& group : kParameterGroups) {
        const bool is_used = has_group(parameters_used(), group);
        const std::size_t n_values = group.values(*this).size(),
                          n_expected_values = is_used ? size() * group.count_floats() : 0;
        if (n_values != n_expected_values)
            fail("cannot use {} {}: the array {} has {} values, expected {}", size(),
                 properties_of(primitive).label, group.name, n_values, n_expected_values);
    }
}

void Surfels::append_surfels(const Surfels& other) {
    if (size() > 0 && other.size() > 0 && primitive != other.primitive)
        fail("cannot join {} with {}, expected runs with the same setting image.primitive",
             properties_of(primitive).label, properties_of(other.primitive).label);
    if (other.size() > 0) primitive = other.primitive;
    if (other.bends) add_still_gait();  // a gait is how a surfel moves while its actor walks
    const std::size_t n = size() + other.size();
    for (const SurfelParameterGroup& group : kParameterGroups) {
        const std::size_t n_before = group.values(*this).size();
        const std::span<const float> added = group.values(other);
        group.resize(*this, n_before + added.size());
        std::ranges::copy(added, group.mutable_values(*this).begin() + static_cast<std::ptrdiff_t>(n_before));
    }
    if (bends) gait.resize(n);  // appended surfels without gaits get gaits without motion
}

Surfels Surfels::reorder(const std::vector<std::uint32_t>& order) const {
    Surfels result;
    result.resize(order.size(), parameters_used());
    for (const SurfelParameterGroup& group : list_groups(parameters_used())) {
        const std::span<const float> from = group.values(*this);
        const std::span<float> to = group.mutable_values(result);
        const std::size_t n = group.count_floats();
        for (std::size_t i = 0; i < order.size(); ++i)
            std::ranges::copy(from.subspan(order[i] * n, n), to.subspan(i * n).begin());
    }
    return result;
}

Surfels Surfels::slice(std::size_t first, std::size_t count) const {
    std::vector<std::uint32_t> order(count);
    std::iota(order.begin(), order.end(), static_cast<std::uint32_t>(first));
    return reorder(order);
}

void convert_surfels(Surfels& surfels, PrimitiveType primitive, double relative_thickness) {
    surfels.primitive = primitive;
    surfels.log_scale_w.clear();
    if (!properties_of(primitive).third_scale) return;
    for (const glm::vec2& s : surfels.log_scale)
        surfels.log_scale_w.push_back(0.5f * (s.x + s.y) + static_cast<float>(std::log(relative_thickness)));
}

Scene replace_background(const Scene& scene, const Surfels& background) {
    const std::uint32_t n_before = scene.models.front().count,  // the background is the first model
        n_after = static_cast<std::uint32_t>(background.size());
    Scene other = strip_surfels(scene);  // keeps models and instances
    other.blocks.clear();
    other.surfels = background.reorder(kd_tree_order(background.mean));
    other.models.front().count = n_after;
    // The surfels of the actors follow the background, so their indices shift.
    for (std::size_t i = 1; i < other.models.size(); ++i)
        other.models[i].first = other.models[i].first - n_before + n_after;
    other.surfels.append_surfels(scene.surfels.slice(n_before, scene.surfels.size() - n_before));
    return other;
}

Scene strip_surfels(const Scene& scene) {
    return {{}, scene.models, scene.instances, scene.sensor_drop, scene.blocks};
}

std::size_t count_surfels(const Scene& scene) {
    std::size_t n = scene.surfels.size();
    for (const SceneBlock& block : scene.blocks) n += block.count;
    return n;
}

Scene wrap_background(Surfels surfels) {
    Scene scene;
    scene.models.push_back({"background", 0, static_cast<std::uint32_t>(surfels.size())});
    scene.instances.push_back({0, ""});
    scene.surfels = std::move(surfels);
    return scene;
}

std::vector<std::uint32_t> kd_tree_order(const std::vector<glm::vec3>& points) {
    std::vector<std::uint32_t> order(points.size());
    std::iota(order.begin(), order.end(), 0u);
    // Stack of the nodes that must still be split: ranges [first, last) of `order`.
    std::vector<std::pair<std::size_t, std::size_t>> ranges{{0, order.size()}};
    while (!ranges.empty()) {
        const auto [first, last] = ranges.back();
        ranges.pop_back();
        if (last - first < 3) continue;  // a node of one or two points is a leaf
        // Splits at the median of the axis along which the points spread most.
        glm::vec3 low(1e30f), high(-1e30f);
        for (std::size_t i = first; i < last; ++i) {
            low = glm::min(low, points[order[i]]);
            high = glm::max(high, points[order[i]]);
        }
        const glm::vec3 size = high - low;
        const int axis = longest_axis(size);
        const std::size_t middle = (first + last) / 2;
        const auto at = [&](std::size_t i) { return order.begin() + static_cast<std::ptrdiff_t>(i); };
        std::nth_element(at(first), at(middle), at(last), [&](std::uint32_t left, std::uint32_t right) {
            return points[left][axis] < points[right][axis];
        });
        ranges.push_back({first, middle});
        ranges.push_back({middle, last});
    }
    return order;
}

/// Checks that the surfels of each model directly follow those of the previous model. The
/// kernels need this order, because they find a surfel's model by binary search.
void check_layout(const Scene& scene) {
    std::size_t next = 0;
    for (const SurfelModel& model : scene.models) {
        if (model.first != next)
            fail("scene: model {} starts at surfel {}, expected {}", model.name, model.first, next);
        next += model.count;
    }
    if (next != scene.surfels.size())
        fail("scene: the models have {} surfels in total, expected {}", next, scene.surfels.size());
    for (const ModelInstance& instance : scene.instances)
        if (instance.model >= scene.models.size())
            fail("scene: an instance uses model {}, expected one of {} models", instance.model,
                 scene.models.size());
}

double actor_extent_m(const glm::vec3& half_size_m) { return 8.0 * double(glm::length(half_size_m)); }

double model_extent_m(const Scene& scene, std::size_t model) {
    if (model >= scene.models.size() || scene.models[model].count == 0) return 1.0;
    const SurfelModel& range = scene.models[model];
    if (range.half_size_m.x > 0.0f) return actor_extent_m(range.half_size_m);
    // Without a box, the distances of the surfels from their centre give the extent.
    const std::span<const glm::vec3> means = std::span(scene.surfels.mean).subspan(range.first, range.count);
    glm::dvec3 centre(0.0);
    for (const glm::vec3& mean : means) centre += glm::dvec3(mean);
    centre /= double(range.count);
    std::vector<double> diameters_m;
    for (const glm::vec3& mean : means) diameters_m.push_back(2.0 * glm::length(glm::dvec3(mean) - centre));
    // The 90th percentile ignores a few surfels that are far away.
    const auto q90 = diameters_m.begin() + static_cast<std::ptrdiff_t>(0.9 * double(diameters_m.size() - 1));
    std::nth_element(diameters_m.begin(), q90, diameters_m.end());
    return 3.0 * *q90;
}

double scene_extent_m(const Scene& scene) { return model_extent_m(scene, 0); }

std::uint32_t append_model(Scene& scene, const Scene& source_scene, std::uint32_t model) {
    SurfelModel added = source_scene.models[model];  // copies the box size and the stride too
    const Surfels surfels = source_scene.surfels.slice(added.first, added.count);
    added.first = static_cast<std::uint32_t>(scene.surfels.size());
    scene.models.push_back(std::move(added));
    scene.surfels.append_surfels(surfels);
    return static_cast<std::uint32_t>(scene.models.size() - 1);
}

Scene unshare_models(Scene scene) {
    std::vector<bool> has_instance(scene.models.size(), false);
    for (ModelInstance& instance : scene.instances) {
        // The first instance keeps the model. Each further instance gets a copy.
        if (!has_instance[instance.model]) {
            has_instance[instance.model] = true;
            continue;
        }
        instance.model = append_model(scene, scene, instance.model);
        has_instance.push_back(true);
    }
    return scene;
}

std::vector<bool> select_instances(const Scene& scene, const std::vector<std::string>& instance_names) {
    std::vector<std::string> part_names = actor_names(scene);
    part_names.insert(part_names.begin(), {"background", "actors"});
    std::vector<bool> selected(scene.instances.size(), false);
    for (const std::string& name : instance_names) {
        if (std::find(part_names.begin(), part_names.end(), name) == part_names.end())
            fail<UsageError>("cannot select the part \"{}\" of the scene{} (known parts: {})", name,
                             did_you_mean(name, part_names, "\""), fmt::join(part_names, ", "));
        for (std::size_t i = 0; i < selected.size(); ++i) {
            const std::string& track = scene.instances[i].track;
            const bool is_background = track.empty();
            const bool is_named = is_background ? name == "background" : name == "actors" || name == track;
            if (is_named) selected[i] = true;
        }
    }
    return selected;
}

}  // namespace relidar
