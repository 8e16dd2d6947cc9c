// SPDX-License-Identifier: Apache-2.0
#include "scene.hpp"

#include <algorithm>

#include <pybind11/stl.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/scene/device_scene.hpp>
#include "arrays.hpp"
#include "module.hpp"

namespace relidar::python {
namespace {

constexpr std::string_view kThirdScale = "log_scale_w", kGait = "gait";

/// Calls `callback` for each parameter array of the surfels, with the name of the array,
/// its values, and the shape of one surfel's values.
template <class Set, class Take>
void for_each_group(Set& surfels, Take&& callback) {
    callback("mean", surfels.mean, Shape{3});
    callback("rotation", surfels.rotation, Shape{4});
    callback("log_scale", surfels.log_scale, Shape{2});
    callback("opacity_logit", surfels.opacity_logit, Shape{});
    callback("sh", surfels.sh, Shape{kShChannels, kShCoefficients});
    callback(kThirdScale.data(), surfels.log_scale_w, Shape{});
    callback(kGait.data(), surfels.gait, Shape{5});
}

/// Returns true if surfels of this kind have a parameter array with this name.
bool has_group(const Surfels& surfels, std::string_view name) {
    if (name == kGait) return surfels.bends;
    return name != kThirdScale || get_primitive_kind(surfels.primitive).third_scale;
}

Shape count_rows_of(py::ssize_t count, const Shape& row) {
    Shape shape{count};
    shape.insert(shape.end(), row.begin(), row.end());
    return shape;
}

/// Returns the parameters of a scene's surfels as read-only numpy arrays, without a copy.
py::dict to_string_view(const py::object& scene_object) {
    const Surfels& surfels = scene_object.cast<const Scene&>().surfels;
    py::dict dict;
    for_each_group(surfels, [&](const char* name, const auto& values, const Shape& row) {
        if (!has_group(surfels, name)) return;
        dict[name] =
            view<float>(values, count_rows_of(static_cast<py::ssize_t>(surfels.size()), row), scene_object);
    });
    return dict;
}

std::uint32_t read_count(const py::dict& dict, const char* name, const char* description) {
    if (!dict.contains(name))
        throw DataError(fmt::format("{}: the dict has no entry \"{}\"", description, name));
    return dict[name].cast<std::uint32_t>();
}

/// Creates a scene from surfels.
/// @param models dicts with name, first and count; without them, all surfels form one
/// model
/// @param instances dicts with model and track; without them, each model has one instance
Scene make_scene(const py::dict& surfels, const std::optional<std::vector<py::dict>>& models,
                 const std::optional<std::vector<py::dict>>& instances) {
    Scene scene = make_background_scene(read_surfels(surfels));
    if (models) {
        scene.models.clear();
        for (const py::dict& model : *models)
            scene.models.push_back(
                {.name = model["name"].cast<std::string>(),
                 .first = read_count(model, "first", "models"),
                 .count = read_count(model, "count", "models"),
                 .stride_m = model.contains("stride_m") ? model["stride_m"].cast<float>() : 0.0f});
    }
    if (models || instances) {
        scene.instances.clear();
        for (std::uint32_t i = 0; !instances && i < scene.models.size(); ++i)
            scene.instances.push_back({i, i == 0 ? "" : scene.models[i].name});
        for (const py::dict& instance : instances.value_or(std::vector<py::dict>{}))
            scene.instances.push_back(
                {read_count(instance, "model", "instances"), instance["track"].cast<std::string>()});
    }
    return scene;
}

py::list list_models(const Scene& scene) {
    py::list list;
    for (const Model& model : scene.models)
        list.append(py::dict(py::arg("name") = model.name, py::arg("first") = model.first,
                             py::arg("count") = model.count));
    return list;
}

py::list list_instances(const Scene& scene) {
    py::list list;
    for (const Instance& instance : scene.instances)
        list.append(py::dict(py::arg("model") = instance.model, py::arg("track") = instance.track));
    return list;
}

}  // namespace

Surfels read_surfels(const py::dict& arrays) {
    Surfels surfels;
    std::vector<std::string> names;
    for_each_group(
        surfels, [&]<class Element>(const char* name, std::vector<Element>& values, const Shape& row) {
            names.emplace_back(name);
            if (arrays.contains(name))
                values = copy_elements<float, Element>(arrays[name], fmt::format("surfels: {}", name),
                                                       count_rows_of(kAny, row));
            else if (name != kThirdScale && name != kGait)
                throw DataError(fmt::format(
                    "surfels: the array \"{}\" is missing, expected mean, rotation, log_scale, opacity_logit "
                    "and sh",
                    name));
        });
    for (const auto& [name, array] : arrays) {
        const std::string text = py::str(name);
        if (std::find(names.begin(), names.end(), text) == names.end())
            throw UsageError(fmt::format("surfels: the array \"{}\" is unknown{} (known: {})", text,
                                         suggest_name(text, names, "\""), fmt::join(names, ", ")));
    }
    // Finds out the kind of primitive. Only 3D Gaussians have an array of third scales;
    // 2D surfels do not.
    const auto kind =
        std::ranges::find(kPrimitives, arrays.contains(kThirdScale), &PrimitiveKind::third_scale);
    surfels.primitive = kind->primitive, surfels.bends = arrays.contains(kGait);
    surfels.check_shapes();
    return surfels;
}

py::dict to_dict(Surfels&& surfels) {
    const auto n = static_cast<py::ssize_t>(surfels.size());
    py::dict dict;
    for_each_group(surfels, [&](const char* name, auto& values, const Shape& row) {
        if (!has_group(surfels, name)) return;
        dict[name] = to_owned_array<float>(std::move(values), count_rows_of(n, row));
    });
    return dict;
}

void add_scene(py::module_& module) {
    py::class_<Scene, std::shared_ptr<Scene>>(
        module, "Scene",
        "Surfels, the models that they belong to, and the instances that place models. It is "
        "immutable.")
        .def(py::init(&make_scene), py::arg("surfels"), py::arg("models") = py::none(),
             py::arg("instances") = py::none(),
             "surfels: dict of float32 arrays: mean [n,3] metres, rotation [n,4] quaternion w x y z, "
             "log_scale [n,2] ln metres, opacity_logit [n],\n"
             "    sh [n,3,16] (intensity, hit logit, drop logit); log_scale_w [n] for 3D Gaussians,\n"
             "    gait [n,5] for models that deform while walking (phase in turns, sharpness, swing "
             "in metres)\n"
             "models: dicts of name, first, count and, for a model that deforms, stride_m: "
             "consecutive ranges of surfels;\n"
             "    None: one model with all surfels, the background\n"
             "instances: dicts of model (its index) and track (\"\" for the background); None: one "
             "instance of each model\n\n"
             "Raises DataError for arrays of wrong shape, dtype or order. Whether models and "
             "instances fit together is checked when the scene is rendered.")
        .def_property_readonly(
            "surfels", [](const py::object& scene) { return to_string_view(scene); },
            "The arrays, read-only and not copied.")
        .def_property_readonly(
            "models", &list_models,
            "Dicts of name, first (index of the first surfel) and count (number of surfels).")
        .def_property_readonly("instances", &list_instances,
                               "Dicts of model and track. Instance 0 is the background.")
        .def(
            "__len__", [](const Scene& scene) { return scene.surfels.size(); }, "Number of surfels.");
}

}  // namespace relidar::python
