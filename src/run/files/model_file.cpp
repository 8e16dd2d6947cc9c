// SPDX-License-Identifier: Apache-2.0
// Reads and writes model.safetensors. JSON in the metadata lists the models, their
// surfels, and the instances. The reader checks all values, because users may have edited
// the file.
#include <relidar/run/run.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <span>

#include <nlohmann/json.hpp>

#include <relidar/base/arrays.hpp>
#include <relidar/scene/device_scene.hpp>

#include "base/fail.hpp"
#include "base/json_field.hpp"
#include "run/files/file_format.hpp"

namespace relidar {
namespace {

constexpr const char* kModelFormat = "relidar model";
constexpr const char *kSurfaceKey = "surface", *kBlocksKey = "blocks", *kSensorDrop = "sensor_drop";
constexpr std::int64_t kMaxSurfels = 4294967295;

/// Throws if a parameter of the surfels, for example the mean, is infinite or NaN.
void check_finite_surfels(const SurfelParameterGroup& group, const Surfels& surfels,
                          const std::string& file) {
    const std::span<const float> values = group.values(surfels);
    const auto bad = std::ranges::find_if(values, [](float v) { return !std::isfinite(v); });
    if (bad == values.end()) return;
    const auto row = static_cast<std::size_t>(bad - values.begin()) / group.count_floats();
    fail("{}: array {}: row {} contains {}, expected finite numbers", file, group.name, row, *bad);
}

/// Reads which parts of a box surface the log has observed, if the file contains them.
std::optional<ObservedBoxSurface> read_surface(const JsonField& model) {
    if (!model.has_member(kSurfaceKey)) return {};
    const JsonField field = model.at(kSurfaceKey);
    ObservedBoxSurface surface(field.at("size_m").vector_in(1e-3, 1e4));
    surface.is_completed = field.at("completed").boolean();
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        const JsonField side = field.at(name_of(BoxSide(s)));
        if (!surface.parse_patches(BoxSide(s), side.text()))
            side.reject("found a text with " + std::to_string(side.text().size()) + " characters",
                        "expected a 0 or 1 for each of " +
                            std::to_string(surface.format_patches(BoxSide(s)).size()) + " patches");
    }
    return surface;
}

/// Converts the observed parts of an actor's box surface to JSON: a text of 0 and 1 for
/// the patches of each side.
nlohmann::ordered_json surface_json(const ObservedBoxSurface& surface) {
    const glm::dvec3 size_m = 2.0 * surface.half_size_m();
    nlohmann::ordered_json json = {{"size_m", {size_m.x, size_m.y, size_m.z}},
                                   {"completed", surface.is_completed}};
    for (std::size_t s = 0; s < kBoxSides; ++s)
        json[name_of(BoxSide(s))] = surface.format_patches(BoxSide(s));
    return json;
}

/// Reads a model, which has the surfels [first, first + count) of the scene.
SurfelModel read_model(const JsonField& field) {
    // The walked distance after which the leg motion repeats; 0 for a rigid model.
    const double stride_m = field.has_member("stride_m") ? field.at("stride_m").number_in(1e-3, 1e6) : 0.0;
    return {field.at("name").text(),
            static_cast<std::uint32_t>(field.at("first").integer_in(0, kMaxSurfels)),
            static_cast<std::uint32_t>(field.at("count").integer_in(0, kMaxSurfels)),
            glm::vec3(field.at("half_size_m").vector_in(0.0, 1e6)),
            float(stride_m),
            read_surface(field)};
}

/// Reads the models and instances of a scene whose surfels are already loaded. The models
/// must cover all surfels in order, without gaps.
void read_models(const JsonField& layout, Scene& scene) {
    const JsonField models = layout.at("models"), instances = layout.at("instances");
    std::size_t n_surfels = 0;  // of the models before model i
    for (std::size_t i = 0; i < models.size(); ++i) {
        const SurfelModel& model = scene.models.emplace_back(read_model(models.at(i)));
        if (model.first != n_surfels)
            models.at(i).at("first").reject(
                fmt::format("found {}", model.first),
                fmt::format(
                    "expected {}, because the surfels of successive models follow each other without gaps",
                    n_surfels));
        n_surfels += model.count;
    }
    if (n_surfels != scene.surfels.size())
        models.reject(fmt::format("found models of {} surfels", n_surfels),
                      fmt::format("expected {} surfels", scene.surfels.size()));
    if (models.size() == 0 || instances.size() == 0)
        models.reject(fmt::format("found {} models and {} instances", models.size(), instances.size()),
                      "expected at least one model and at least one instance");
    for (std::size_t i = 0; i < instances.size(); ++i) {
        const JsonField instance = instances.at(i);
        const std::int64_t model =
            instance.at("model").integer_in(0, static_cast<std::int64_t>(models.size()) - 1);
        scene.instances.push_back({static_cast<std::uint32_t>(model), instance.at("track").text()});
    }
}

/// Converts the list of background blocks to JSON. File names are relative to the folder
/// of the model, so that the folder can be moved.
std::string format_blocks(const Scene& scene, const std::filesystem::path& model_folder) {
    nlohmann::ordered_json json = nlohmann::ordered_json::array();
    for (const SceneBlock& b : scene.blocks)
        json.push_back({{"file", b.file.lexically_relative(model_folder).generic_string()},
                        {"surfels", b.count},
                        {"low_m", {b.low_m.x, b.low_m.y, b.low_m.z}},
                        {"high_m", {b.high_m.x, b.high_m.y, b.high_m.z}}});
    return json.dump();
}

/// Reads the list of background blocks from JSON: file, number of surfels, and corners of
/// the bounding box. Rejects files outside the folder of the model, because a run from
/// another source must not read other files.
void parse_blocks(const std::string& json_text, const std::string& where,
                  const std::filesystem::path& model_folder, Scene& scene) {
    const nlohmann::json json = parse_json(json_text, where);
    const JsonField blocks(json, where, "");
    for (std::size_t i = 0; i < blocks.size(); ++i) {
        const JsonField block = blocks.at(i);
        const std::filesystem::path file = block.at("file").text();
        const bool goes_up = std::ranges::find(file, std::filesystem::path("..")) != file.end();
        if (file.empty() || file.is_absolute() || goes_up)
            block.at("file").reject("found the file name " + file.string(),
                                    "expected the name of a file in the folder of the model");
        const auto read_corner = [&](const char* name) {
            return glm::vec3(block.at(name).vector_in(-1e7, 1e7));
        };
        scene.blocks.push_back({model_folder / file,
                                static_cast<std::uint32_t>(block.at("surfels").integer_in(0, kMaxSurfels)),
                                read_corner("low_m"), read_corner("high_m")});
    }
}

/// Reads the ray-drop probabilities [channels, bins] of the sensor, if the file has them.
void read_drop_table(const files::ArrayFile& file, Scene& scene) {
    using files::kAnyLength;
    if (!find_array(file.arrays, kSensorDrop)) return;
    const NamedArray& array = file.find(kSensorDrop, "f4", {kAnyLength, kAnyLength});
    scene.sensor_drop = {int(array.shape[0]), int(array.shape[1]), array.to_floats()};
    for (const float p : scene.sensor_drop.probability)
        if (!(p >= 0.0f && p <= 1.0f))
            fail("{}: array {}: found {}, expected probabilities from 0 to 1", file.path, kSensorDrop, p);
}

}  // namespace

std::string format_layout(const Scene& scene) {
    nlohmann::ordered_json json = {{"models", nlohmann::ordered_json::array()},
                                   {"instances", nlohmann::ordered_json::array()}};
    for (const SurfelModel& m : scene.models) {
        nlohmann::ordered_json model = {{"name", m.name},
                                        {"first", m.first},
                                        {"count", m.count},
                                        {"half_size_m", {m.half_size_m.x, m.half_size_m.y, m.half_size_m.z}}};
        if (m.stride_m > 0.0f) model["stride_m"] = m.stride_m;  // the model changes its shape
        if (m.surface) model[kSurfaceKey] = surface_json(*m.surface);
        json["models"].push_back(std::move(model));
    }
    for (const ModelInstance& i : scene.instances)
        json["instances"].push_back({{"model", i.model}, {"track", i.track}});
    // `replace` prevents an exception if a name is not valid UTF-8.
    return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

void parse_layout(const std::string& text, const std::string& where, Scene& scene) {
    const nlohmann::json layout = parse_json(text, where);
    read_models(JsonField(layout, where, ""), scene);
}

void save_model(const std::filesystem::path& path, const Scene& scene) {
    scene.surfels.check_lengths();
    std::vector<NamedArray> arrays;
    for (const SurfelParameterGroup& group : list_groups(scene.surfels.parameters_used())) {
        check_finite_surfels(group, scene.surfels, path.string());
        const std::span<const float> values = group.values(scene.surfels);
        arrays.push_back(
            make_array(group.name, group.array_shape(scene.surfels.size()), values.data(), values.size()));
    }
    const RayDropTable& drop = scene.sensor_drop;
    if (!drop.empty())
        arrays.push_back(make_array(kSensorDrop, {std::size_t(drop.channels), std::size_t(drop.bins)},
                                    drop.probability.data(), drop.probability.size()));
    std::map<std::string, std::string> metadata{{kPrimitiveKey, properties_of(scene.surfels.primitive).name},
                                                {"layout", format_layout(scene)}};
    if (!scene.blocks.empty()) metadata[kBlocksKey] = format_blocks(scene, path.parent_path());
    files::write_array_file(path, arrays, kModelFormat, std::move(metadata));
}

/// Loads a scene from a safetensors file. Its metadata has the models and instances
/// (layout) and the background blocks. Checks the shape of every array before it
/// allocates memory, because the file may be damaged.
Scene load_model(const std::filesystem::path& path) {
    const files::ArrayFile file(path, kModelFormat);
    const auto layout = file.metadata.find("layout");
    const auto blocks = file.metadata.find(kBlocksKey);
    if (layout == file.metadata.end())
        fail("{}: the metadata has no entry \"layout\", expected a model file that relidar has written",
             file.path);
    const std::size_t n_surfels = file.find("mean", "f4", {files::kAnyLength, 3}).shape[0];
    const SurfelParameterSet parameters =
        read_parameter_set(file.path, file.metadata, kPrimitiveKey,
                           [&](const char* name) { return find_array(file.arrays, name) != nullptr; });
    for (const SurfelParameterGroup& group : list_groups(parameters))
        file.find(group.name, "f4", group.array_shape(n_surfels));  // throws if the shape differs

    Scene scene;
    scene.surfels.resize(n_surfels, parameters);
    for (const SurfelParameterGroup& group : list_groups(parameters)) {
        std::ranges::copy(find_array(file.arrays, group.name)->to_floats(),
                          group.mutable_values(scene.surfels).begin());
        check_finite_surfels(group, scene.surfels, file.path);
    }
    parse_layout(layout->second, file.path + ": metadata layout", scene);
    read_drop_table(file, scene);
    if (blocks != file.metadata.end())
        parse_blocks(blocks->second, file.path + ": metadata " + kBlocksKey, path.parent_path(), scene);
    return scene;
}

Surfels load_block(const SceneBlock& block) {
    const Scene scene = load_model(block.file);
    // The background is the first model, so its surfels precede all others.
    const SurfelModel& background = scene.models.front();
    if (background.count != block.count)
        fail(
            "{}: this file of a block has {} background surfels, but model.safetensors of the run lists {} "
            "for the block; expected the file that was saved with the run",
            block.file.string(), background.count, block.count);
    return scene.surfels.slice(0, background.count);
}

Scene with_blocks(const Scene& scene, const std::vector<std::size_t>& block_indices) {
    Surfels background = scene.surfels.slice(0, scene.models.front().count);
    for (const std::size_t i : block_indices) background.append_surfels(load_block(scene.blocks[i]));
    return replace_background(scene, background);
}

Scene with_all_blocks(const Scene& scene) {
    if (scene.blocks.empty()) return scene;
    std::vector<std::size_t> all(scene.blocks.size());
    std::iota(all.begin(), all.end(), std::size_t(0));
    return with_blocks(scene, all);
}

}  // namespace relidar
