// SPDX-License-Identifier: Apache-2.0
// Reads and writes model.safetensors, which stores the parameters of all surfels of a
// scene. Each parameter group is one array. JSON in the metadata lists the models, the
// range of surfels of each model, and the instances. The reader checks all values,
// because users may have edited the file.
#include <relidar/run/run.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <span>
#include <string_view>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>
#include <relidar/scene/device_scene.hpp>
#include "base/files.hpp"
#include "base/json_field.hpp"

#include "run/files/file_format.hpp"

namespace relidar {
namespace {

constexpr const char* kModelFormat = "relidar model";
constexpr const char* kModelVersion = "1";
constexpr std::int64_t kMaxSurfels = 4294967295;

void check_finite(const ParameterGroup& group, const Surfels& surfels, const std::string& file) {
    const std::span<const float> values = group.values(surfels);
    const auto bad = std::ranges::find_if(values, [](float v) { return !std::isfinite(v); });
    if (bad == values.end()) return;
    const auto row = static_cast<std::size_t>(bad - values.begin()) / group.floats();
    throw DataError(fmt::format("{}: array {}: row {} contains {}, expected finite numbers", file, group.name,
                                row, *bad));
}

const NamedArray& find_array_by_name(const std::vector<NamedArray>& arrays, std::string_view name,
                                     const std::string& file) {
    const NamedArray* array = find_array(arrays, name);
    if (!array) throw DataError(fmt::format("{}: the array {} is missing", file, name));
    return *array;
}

void read_group(const ParameterGroup& group, const NamedArray& array, Surfels& surfels,
                const std::string& file) {
    const std::vector<std::size_t> expected = group.shape(surfels.size());
    if (array.shape != expected || array.dtype != "f4") {
        throw DataError(fmt::format("{}: array {}: found {} [{}], expected f4 [{}]", file, group.name,
                                    array.dtype, fmt::join(array.shape, ", "), fmt::join(expected, ", ")));
    }
    const std::vector<float> values = array.as_float();
    std::ranges::copy(values, group.mutable_values(surfels).begin());
    check_finite(group, surfels, file);
}

/// Reads the half size of a model's bounding box. The size 0, 0, 0 means that the model
/// is unbounded.
glm::vec3 read_half_size(const JsonField& model) {
    const std::array<double, 3> v = model.at("half_size_m").numbers<3>();
    for (std::size_t k = 0; k < 3; ++k) model.at("half_size_m").at(k).number(0.0, 1e6);
    return {float(v[0]), float(v[1]), float(v[2])};
}

/// Reads the distance that a person walks until the leg motion repeats. Returns 0 for a
/// rigid model.
float read_stride(const JsonField& model) {
    return model.has("stride_m") ? static_cast<float>(model.at("stride_m").number(1e-3, 1e6)) : 0.0f;
}

constexpr const char* kSurface = "surface";

/// Reads which parts of an actor's box surface the log has observed. Returns nothing if
/// the file has no such data.
std::optional<BoxSurface> read_surface(const JsonField& model) {
    if (!model.has(kSurface)) return {};
    const JsonField field = model.at(kSurface), size = field.at("size_m");
    const std::array<double, 3> size_m = size.numbers<3>();
    for (std::size_t k = 0; k < 3; ++k) size.at(k).number(1e-3, 1e4);
    BoxSurface surface({size_m[0], size_m[1], size_m[2]});
    surface.is_completed = field.at("completed").boolean();
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        const JsonField side = field.at(get_name(BoxSide(s)));
        if (!surface.parse_patches(BoxSide(s), side.text()))
            side.fail("found a text of " + std::to_string(side.text().size()) + " characters",
                      "expected a 0 or 1 for each of " + std::to_string(surface.patches(BoxSide(s)).size()) +
                          " patches");
    }
    return surface;
}

nlohmann::ordered_json surface_to_json(const BoxSurface& surface) {
    const glm::dvec3 size_m = 2.0 * surface.half_size_m();
    nlohmann::ordered_json json = {{"size_m", {size_m.x, size_m.y, size_m.z}},
                                   {"completed", surface.is_completed}};
    for (std::size_t s = 0; s < kBoxSides; ++s) json[get_name(BoxSide(s))] = surface.patches(BoxSide(s));
    return json;
}

void read_layout(const JsonField& layout, Scene& scene) {
    const auto n = static_cast<std::int64_t>(scene.surfels.size());
    const JsonField models = layout.at("models"), instances = layout.at("instances");
    std::int64_t next = 0;
    for (std::size_t i = 0; i < models.size(); ++i) {
        const JsonField m = models.at(i);
        const std::int64_t first = m.at("first").integer(0, kMaxSurfels),
                           count = m.at("count").integer(0, kMaxSurfels);
        if (first != next)
            m.at("first").fail(fmt::format("found {}", first),
                               fmt::format("expected {}, the first surfel after the previous model", next));
        next = first + count;
        scene.models.push_back({m.at("name").text(), static_cast<std::uint32_t>(first),
                                static_cast<std::uint32_t>(count), read_half_size(m), read_stride(m),
                                read_surface(m)});
    }
    if (next != n)
        models.fail(fmt::format("found models of {} surfels", next), fmt::format("expected {}", n));
    if (models.size() == 0 || instances.size() == 0)
        models.fail("found no model or no instance", "expected at least one of each");
    for (std::size_t i = 0; i < instances.size(); ++i) {
        const JsonField instance = instances.at(i);
        const std::int64_t model =
            instance.at("model").integer(0, static_cast<std::int64_t>(models.size()) - 1);
        scene.instances.push_back({static_cast<std::uint32_t>(model), instance.at("track").text()});
    }
}

void check_metadata(const std::map<std::string, std::string>& metadata, const std::string& file) {
    run_detail::check_format(metadata, file, kModelFormat, kModelVersion);
    if (!metadata.contains("layout"))
        throw DataError(fmt::format("{}: the metadata key \"layout\" is missing", file));
}

constexpr const char* kBlocks = "blocks";

/// Converts the list of background blocks to JSON. File names are relative to the model's
/// folder.
std::string format_blocks_json(const Scene& scene, const std::filesystem::path& folder) {
    nlohmann::ordered_json json = nlohmann::ordered_json::array();
    for (const SceneBlock& b : scene.blocks)
        json.push_back({{"file", b.file.lexically_relative(folder).generic_string()},
                        {"surfels", b.count},
                        {"low_m", {b.low_m.x, b.low_m.y, b.low_m.z}},
                        {"high_m", {b.high_m.x, b.high_m.y, b.high_m.z}}});
    return json.dump();
}

glm::vec3 read_corner(const JsonField& field) {
    const std::array<double, 3> v = field.numbers<3>();
    for (std::size_t k = 0; k < 3; ++k) field.at(k).number(-1e7, 1e7);
    return {float(v[0]), float(v[1]), float(v[2])};
}

/// Reads the list of background blocks from JSON.
/// @param folder  folder of the model, which must contain the files of the blocks
void read_blocks_json(const std::string& text, const std::string& location,
                      const std::filesystem::path& folder, Scene& scene) {
    const nlohmann::json json = parse_json(text, location);
    const JsonField blocks(json, location, "");
    for (std::size_t i = 0; i < blocks.size(); ++i) {
        const JsonField block = blocks.at(i);
        const std::filesystem::path file = block.at("file").text();
        const bool goes_up = std::ranges::find(file, std::filesystem::path("..")) != file.end();
        if (file.empty() || file.is_absolute() || goes_up)
            block.at("file").fail("found " + file.string(),
                                  "expected the name of a file in the folder of the model");
        scene.blocks.push_back({folder / file,
                                static_cast<std::uint32_t>(block.at("surfels").integer(0, kMaxSurfels)),
                                read_corner(block.at("low_m")), read_corner(block.at("high_m"))});
    }
}

constexpr const char* kSensorDrop = "sensor_drop";

/// Reads the table [channels, bins] of the sensor's ray-drop probabilities, if the file
/// contains it.
void read_sensor_drop(const std::vector<NamedArray>& arrays, Scene& scene, const std::string& file) {
    const auto it =
        std::find_if(arrays.begin(), arrays.end(), [](const NamedArray& a) { return a.name == kSensorDrop; });
    if (it == arrays.end()) return;
    if (it->shape.size() != 2 || it->dtype != "f4" || it->shape[0] > 65536 || it->shape[1] > 65536)
        throw DataError(fmt::format("{}: array {}: found {} [{}], expected f4 [channels, bins]", file,
                                    kSensorDrop, it->dtype, fmt::join(it->shape, ", ")));
    scene.sensor_drop = {static_cast<int>(it->shape[0]), static_cast<int>(it->shape[1]), it->as_float()};
    for (const float p : scene.sensor_drop.probability)
        if (!(p >= 0.0f && p <= 1.0f))
            throw DataError(fmt::format("{}: array {}: found {}, expected probabilities from 0 to 1", file,
                                        kSensorDrop, p));
}

}  // namespace

std::string layout_to_json(const Scene& scene) {
    nlohmann::ordered_json json = {{"models", nlohmann::ordered_json::array()},
                                   {"instances", nlohmann::ordered_json::array()}};
    for (const Model& m : scene.models) {
        json["models"].push_back({{"name", m.name},
                                  {"first", m.first},
                                  {"count", m.count},
                                  {"half_size_m", {m.half_size_m.x, m.half_size_m.y, m.half_size_m.z}}});
        if (m.stride_m > 0.0f) json["models"].back()["stride_m"] = m.stride_m;
        if (m.surface) json["models"].back()[kSurface] = surface_to_json(*m.surface);
    }
    for (const Instance& i : scene.instances)
        json["instances"].push_back({{"model", i.model}, {"track", i.track}});
    return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

void read_layout_json(const std::string& text, const std::string& location, Scene& scene) {
    const nlohmann::json layout = parse_json(text, location);
    read_layout(JsonField(layout, location, ""), scene);
}

void save_model(const std::filesystem::path& path, const Scene& scene) {
    scene.surfels.check_shapes();
    std::vector<NamedArray> arrays;
    for (const ParameterGroup& group : list_parameter_groups(scene.surfels.parameters())) {
        check_finite(group, scene.surfels, path.string());
        const std::span<const float> values = group.values(scene.surfels);
        arrays.push_back(
            make_array(group.name, group.shape(scene.surfels.size()), values.data(), values.size()));
    }
    const DropTable& drop = scene.sensor_drop;
    if (!drop.empty())
        arrays.push_back(make_array(kSensorDrop, {std::size_t(drop.channels), std::size_t(drop.bins)},
                                    drop.probability.data(), drop.probability.size()));
    std::map<std::string, std::string> metadata{
        {"format", kModelFormat},
        {"version", kModelVersion},
        {"relidar", RELIDAR_VERSION},
        {kPrimitiveKey, get_primitive_kind(scene.surfels.primitive).name},
        {"layout", layout_to_json(scene)}};
    if (!scene.blocks.empty()) metadata[kBlocks] = format_blocks_json(scene, path.parent_path());
    write_safetensors(path, arrays, metadata);
}

Scene load_model(const std::filesystem::path& path) {
    const std::string file = path.string();
    if (!does_path_exist(path)) throw DataError(fmt::format("{}: no such file", file));
    std::map<std::string, std::string> metadata;
    const std::vector<NamedArray> arrays = read_safetensors(path, &metadata);
    check_metadata(metadata, file);
    const NamedArray& mean = find_array_by_name(arrays, "mean", file);
    if (mean.shape.empty() || mean.shape[0] > static_cast<std::size_t>(kMaxSurfels))
        throw DataError(fmt::format("{}: array mean: found shape [{}], expected [n, 3]", file,
                                    fmt::join(mean.shape, ", ")));
    const ParameterSet parameters = read_parameter_set(
        metadata, kPrimitiveKey, [&](const char* name) { return find_array(arrays, name) != nullptr; });
    // Checks the number of rows of every array before memory is allocated.
    for (const ParameterGroup& group : list_parameter_groups(parameters)) {
        const NamedArray& array = find_array_by_name(arrays, group.name, file);
        if (array.shape.empty() || array.shape[0] != mean.shape[0])
            throw DataError(
                fmt::format("{}: array {}: found shape [{}], expected {} rows like in the array mean", file,
                            group.name, fmt::join(array.shape, ", "), mean.shape[0]));
    }
    Scene scene;
    scene.surfels.resize(mean.shape[0], parameters);
    for (const ParameterGroup& group : list_parameter_groups(parameters))
        read_group(group, find_array_by_name(arrays, group.name, file), scene.surfels, file);
    read_layout_json(metadata.at("layout"), file + ": metadata layout", scene);
    read_sensor_drop(arrays, scene, file);
    if (const auto blocks = metadata.find(kBlocks); blocks != metadata.end())
        read_blocks_json(blocks->second, file + ": metadata " + kBlocks, path.parent_path(), scene);
    return scene;
}

}  // namespace relidar
