// SPDX-License-Identifier: Apache-2.0
#include "conversions.hpp"

#include <algorithm>

#include <pybind11/stl.h>

#include <relidar/scene/device_scene.hpp>
#include "arrays.hpp"
#include "base/fail.hpp"
#include "integers.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

NumpyShape array_shape(const SurfelParameterGroup& group, std::size_t n) {
    const std::vector<std::size_t> shape = group.array_shape(n);
    return {shape.begin(), shape.end()};
}

/// Returns the surfel arrays without a copy. Each array keeps the Python scene alive.
py::dict surfel_views(const py::object& scene_object) {
    const Surfels& surfels = scene_object.cast<const Scene&>().surfels;
    py::dict dict;
    for (const SurfelParameterGroup& group : list_groups(surfels.parameters_used())) {
        const py::array array(py::dtype::of<float>(), array_shape(group, surfels.size()),
                              group.values(surfels).data(), scene_object);
        array.attr("setflags")(py::arg("write") = false);
        dict[group.name] = array;
    }
    return dict;
}

std::uint32_t read_uint32(const py::dict& dict, const char* entry_name, const char* where) {
    if (!dict.contains(entry_name)) fail("{}: the dict has no entry \"{}\"", where, entry_name);
    return read_integer<std::uint32_t>(dict[entry_name], fmt::format("{}: {}", where, entry_name));
}

/// Creates a scene from surfels. Model 0 is the background.
/// @param models dicts with name, first and count; without them, all surfels form one
/// model
/// @param instances dicts with model and track; without them, each model has one
/// instance, whose track has the name of the model
Scene make_scene(const py::dict& arrays, const std::optional<std::vector<py::dict>>& models,
                 const std::optional<std::vector<py::dict>>& instances) {
    Scene scene = wrap_background(read_surfels(arrays));
    if (models) {
        scene.models.clear();
        for (const py::dict& model : *models)
            scene.models.push_back(
                {.name = model["name"].cast<std::string>(),
                 .first = read_uint32(model, "first", "models"),
                 .count = read_uint32(model, "count", "models"),
                 .stride_m = model.contains("stride_m") ? model["stride_m"].cast<float>() : 0.0f});
    }
    if (instances) {
        scene.instances.clear();
        for (const py::dict& instance : *instances)
            scene.instances.push_back({.model = read_uint32(instance, "model", "instances"),
                                       .track = instance["track"].cast<std::string>()});
    } else if (models) {
        scene.instances.clear();
        for (std::uint32_t model = 0; model < scene.models.size(); ++model)
            scene.instances.push_back({.model = model, .track = model == 0 ? "" : scene.models[model].name});
    }
    return scene;
}

py::list model_dicts(const Scene& scene) {
    py::list list;
    for (const SurfelModel& model : scene.models)
        list.append(py::dict(py::arg("name") = model.name, py::arg("first") = model.first,
                             py::arg("count") = model.count));
    return list;
}

py::list instance_dicts(const Scene& scene) {
    py::list list;
    for (const ModelInstance& instance : scene.instances)
        list.append(py::dict(py::arg("model") = instance.model, py::arg("track") = instance.track));
    return list;
}

}  // namespace

/// Converts a dict of float arrays, one for each parameter, to surfels.
/// @throws UsageError for an unknown name, DataError for a missing or wrong array
Surfels read_surfels(const py::dict& arrays) {
    std::vector<std::string> names;
    for (const SurfelParameterGroup& group : kParameterGroups) names.emplace_back(group.name);
    for (const auto& [name, array] : arrays) {
        const std::string text = py::str(name);
        if (std::ranges::find(names, text) == names.end())
            fail<UsageError>("surfels: the array \"{}\" is unknown{} (known: {})", text,
                             did_you_mean(text, names, "\""), fmt::join(names, ", "));
    }
    // Only 3D Gaussians have an array of third scales.
    const auto kind =
        std::ranges::find(kPrimitives, arrays.contains("log_scale_w"), &PrimitiveProperties::third_scale);
    Surfels surfels;
    surfels.primitive = kind->primitive;
    surfels.bends = arrays.contains("gait");
    for (const SurfelParameterGroup& group : list_groups(surfels.parameters_used())) {
        if (!arrays.contains(group.name))
            fail(
                "surfels: the array \"{}\" is missing, expected mean, rotation, log_scale, opacity_logit and "
                "sh",
                group.name);
        NumpyShape shape = array_shape(group, 0);
        shape.front() = kAnyLength;
        const py::object array = to_numpy(arrays[group.name]);
        const auto values = array_values<float>(array, fmt::format("surfels: {}", group.name), shape);
        group.resize(surfels, values.size());
        std::ranges::copy(values, group.mutable_values(surfels).begin());
    }
    surfels.check_lengths();
    return surfels;
}

py::dict to_array_dict(Surfels&& surfels) {
    auto* owned = new Surfels(std::move(surfels));
    const py::capsule owner(owned, [](void* p) { delete static_cast<Surfels*>(p); });
    py::dict dict;
    for (const SurfelParameterGroup& group : list_groups(owned->parameters_used()))
        dict[group.name] = py::array(py::dtype::of<float>(), array_shape(group, owned->size()),
                                     group.values(*owned).data(), owner);
    return dict;
}

/// Adds relidar.Scene, which holds surfels, models and instances.
void bind_scene(py::module_& module) {
    py::class_<Scene, std::shared_ptr<Scene>>(
        module, "Scene",
        "Surfels, the models that they belong to, and the instances that place models. It is immutable.")
        .def(py::init(&make_scene), py::arg("surfels"), py::arg("models") = py::none(),
             py::arg("instances") = py::none(),
             "surfels: dict of float32 arrays:\n"
             "    mean [n,3]: metres\n"
             "    rotation [n,4]: quaternion w x y z\n"
             "    log_scale [n,2]: ln metres\n"
             "    opacity_logit [n]\n"
             "    sh [n,3,16]: for intensity, hit logit and drop logit\n"
             "    log_scale_w [n]: ln metres, only for 3D Gaussians\n"
             "    gait [n,5], only for models that deform while walking: phase in turns, sharpness, swing x "
             "y z in metres\n"
             "models: dicts of name, first, count and, for a model that deforms, stride_m: consecutive "
             "ranges of surfels;\n"
             "    None: one model with all surfels, the background\n"
             "instances: dicts of model (its index) and track (\"\" for the background); None: one instance "
             "of each model\n\n"
             "Raises DataError for arrays of wrong shape, dtype or order. Whether models and instances fit "
             "together is checked when the scene is rendered.")
        .def_property_readonly(
            "surfels", [](const py::object& scene) { return surfel_views(scene); },
            "The arrays, read-only and not copied.")
        .def_property_readonly(
            "models", &model_dicts,
            "Dicts of name, first (index of the first surfel) and count (number of surfels).")
        .def_property_readonly(
            "instances", &instance_dicts,
            "List of dicts with the keys model (its index) and track. Entry 0 is the background.")
        .def(
            "__len__", [](const Scene& scene) { return scene.surfels.size(); }, "Number of surfels.");
}

}  // namespace relidar::python
