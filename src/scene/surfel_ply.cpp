// SPDX-License-Identifier: Apache-2.0
// Writes and reads surfels as PLY files in the layout of 3D Gaussian splatting. A surfel
// is stored as a flat Gaussian. The LiDAR channels are additional properties. The reader
// compares each number in the header with the file size before it uses the number.
#include <relidar/scene/surfel_ply.hpp>

#include <charconv>
#include <numeric>
#include <set>
#include <sstream>
#include <tuple>
#include <unordered_map>

#include <relidar/scene/device_scene.hpp>
#include "base/codecs/file_io.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/geometry/cell_key.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr std::uint32_t kColourChannels = 3;
constexpr std::uint32_t kRestCoefficients = kShCoefficients - 1;
// Logarithm of the thickness of a surfel in metres, which viewers of ellipsoids need.
const float kFlatLogScale = std::log(1e-4f);
constexpr std::size_t kMaxPlyHeader = 65536;
constexpr std::size_t kMaxSurfels = 4294967295;

const auto& [kGait, kMean, kRotation, kLogScale, kOpacityLogit, kSh, kLogScaleW] = kParameterGroups;

/// A property (column) of the PLY file. The three colours all hold the intensity.
struct PlyProperty {
    std::string name;
    const SurfelParameterGroup* group = nullptr;  ///< parameter group of the property, or null
    std::uint32_t index = 0;  ///< index in a row of the group, or component (x, y, z) of the normal
    bool is_read = true;      ///< false if the reader ignores the property
    enum Kind { parameter, normal, thickness, model } kind = parameter;

    /// Value of the parameter for surfel i. Only for the kind `parameter`.
    const float& value_in(const Surfels& surfels, std::size_t i) const {
        return group->values(surfels)[i * group->count_floats() + index];
    }
    float& value_in(Surfels& surfels, std::size_t i) const {
        return group->mutable_values(surfels)[i * group->count_floats() + index];
    }
};

/// Returns the properties of a PLY file, in the order of the values of a surfel.
std::vector<PlyProperty> list_properties(SurfelParameterSet parameters) {
    std::vector<PlyProperty> list;
    // Adds prefix0, prefix1, ... for the values of a group from `first` on.
    const auto add = [&](const std::string& prefix, std::uint32_t count, const SurfelParameterGroup& group,
                         std::uint32_t first = 0) {
        for (std::uint32_t k = 0; k < count; ++k)
            list.push_back({.name = fmt::format("{}{}", prefix, k), .group = &group, .index = first + k});
    };
    for (std::uint32_t k = 0; k < 3; ++k)
        list.push_back({.name = std::string(1, "xyz"[k]), .group = &kMean, .index = k});
    for (std::uint32_t k = 0; k < 3; ++k)
        list.push_back(
            {.name = std::string("n") + "xyz"[k], .index = k, .is_read = false, .kind = PlyProperty::normal});
    // Each colour channel repeats the intensity. Only the first is read back.
    for (std::uint32_t c = 0; c < kColourChannels; ++c)
        list.push_back({.name = fmt::format("f_dc_{}", c), .group = &kSh, .is_read = c == 0});
    // The SH functions of each channel, except function 0, which is f_dc.
    for (std::uint32_t k = 0; k < kColourChannels * kRestCoefficients; ++k)
        list.push_back({.name = fmt::format("f_rest_{}", k),
                        .group = &kSh,
                        .index = k % kRestCoefficients + 1,
                        .is_read = k < kRestCoefficients});
    list.push_back({.name = "opacity", .group = &kOpacityLogit});
    add("scale_", 2, kLogScale);
    // A primitive without a third scale is flat. Viewers get a constant thickness.
    if (properties_of(parameters.primitive).third_scale)
        list.push_back({.name = "scale_2", .group = &kLogScaleW});
    else list.push_back({.name = "scale_2", .is_read = false, .kind = PlyProperty::thickness});
    add("rot_", 4, kRotation);
    // kSh stores the functions of intensity, then of hits, then of drops.
    add("hit_", kShCoefficients, kSh, kShCoefficients);
    add("drop_", kShCoefficients, kSh, 2 * kShCoefficients);
    if (parameters.bends) add("gait_", kGait.count_floats(), kGait);
    list.push_back({.name = "model", .kind = PlyProperty::model});
    return list;
}

/// Returns the normal of a surfel, the third column of its rotation matrix. Returns zero
/// if the quaternion is zero or not a number.
glm::vec3 quaternion_normal(const glm::vec4& wxyz) {
    const float length = glm::length(wxyz);
    if (!(length > 0.0f)) return glm::vec3(0.0f);
    const glm::vec4 q = wxyz / length;
    return {2.0f * (q.y * q.w + q.x * q.z), 2.0f * (q.z * q.w - q.x * q.y),
            1.0f - 2.0f * (q.y * q.y + q.z * q.z)};
}

/// Returns the value of a PLY property for surfel i, which belongs to the given model.
float property_value(const PlyProperty& property, const Surfels& surfels, std::size_t i, std::size_t model) {
    switch (property.kind) {
        case PlyProperty::parameter: return property.value_in(surfels, i);
        case PlyProperty::normal:
            return quaternion_normal(surfels.rotation[i])[static_cast<int>(property.index)];
        case PlyProperty::thickness: return kFlatLogScale;
        case PlyProperty::model: return float(model);
    }
    return 0.0f;
}

/// Number of records in a PLY file, and name and byte offset of each property.
struct PlyRecordLayout {
    std::size_t count = 0, stride = 0;  ///< stride: bytes per record
    struct Field {
        std::string name;
        bool is_float;
        std::size_t offset;
    };
    std::vector<Field> fields;
};

/// Returns the size of a number in a PLY file from the name of its type.
std::size_t type_bytes(const std::string& type_name) {
    for (const char* t : {"char", "uchar", "int8", "uint8"})
        if (type_name == t) return 1;
    for (const char* t : {"short", "ushort", "int16", "uint16"})
        if (type_name == t) return 2;
    for (const char* t : {"int", "uint", "int32", "uint32", "float", "float32"})
        if (type_name == t) return 4;
    for (const char* t : {"double", "float64"})
        if (type_name == t) return 8;
    fail("found a property of type \"{}\", expected a number type (lists are not supported)",
         quote(type_name));
}

/// Parses the header of a PLY file, and computes the byte offset of each property.
/// @throws DataError for another format than binary_little_endian, for lists, and for
/// other elements than `vertex`
PlyRecordLayout parse_ply_header(const std::string& header) {
    PlyRecordLayout layout;
    bool has_vertex = false, has_format = false;
    std::istringstream lines(header);
    std::string line;
    for (int number = 1; std::getline(lines, line); ++number) {
        if (!line.empty() && line.back() == '\r') line.pop_back();
        if (number == 1 && line != "ply") throw DataError("the first line is not \"ply\"");
        std::istringstream words(line);
        std::string keyword;
        words >> keyword;
        if (keyword == "format") {
            has_format = true;
            std::string format;
            words >> format;
            if (format != "binary_little_endian")
                fail("found format {}, expected binary_little_endian", quote(format));
        } else if (keyword == "element") {
            std::string element, count;
            words >> element >> count;
            if (element != "vertex" || has_vertex)
                fail("found the PLY element {}, expected only one element, vertex", quote(element));
            has_vertex = true;
            const char* const end = count.data() + count.size();
            const auto [stop, error] = std::from_chars(count.data(), end, layout.count);
            if (error != std::errc() || stop != end || layout.count > kMaxSurfels)
                fail("found \"element vertex {}\", expected a count of at most {}", quote(count),
                     kMaxSurfels);
        } else if (keyword == "property") {
            std::string type, name;
            words >> type >> name;
            if (!has_vertex)
                fail("the PLY property {} comes before the element vertex, expected after it", quote(name));
            if (std::ranges::find(layout.fields, name, &PlyRecordLayout::Field::name) != layout.fields.end())
                fail("property {} occurs twice, expected it once", quote(name));
            layout.fields.push_back({name, type == "float" || type == "float32", layout.stride});
            layout.stride += type_bytes(type);
        }
    }
    if (!has_format || !has_vertex)
        throw DataError("the header lacks the line \"format\" or \"element vertex\", expected both");
    return layout;
}

/// Properties that the reader uses.
struct PlyColumns {
    struct Column {
        PlyProperty property;
        std::size_t offset;  ///< bytes from the start of a record
    };
    std::vector<Column> present;
    std::vector<PlyProperty> missing;
};

/// Returns the number of properties f_rest_... of a colour: the SH functions above degree
/// 0, which are 3, 8 or 15 in a file of degree 1, 2 or 3.
std::uint32_t count_rest_functions(const PlyRecordLayout& layout) {
    const auto n_rest = std::ranges::count_if(
        layout.fields, [](const auto& field) { return field.name.starts_with("f_rest_"); });
    for (const std::uint32_t n : {3u, 8u})
        if (n_rest == kColourChannels * n) return n;
    return kRestCoefficients;
}

/// Finds the properties that the reader uses. Lists the missing ones separately, because
/// the surfels of the run can supply them.
PlyColumns find_columns(const PlyRecordLayout& layout, SurfelParameterSet parameters) {
    PlyColumns columns;
    const std::uint32_t n_rest = count_rest_functions(layout);
    for (const PlyProperty& property : list_properties(parameters)) {
        if (!property.is_read) continue;
        const auto field = std::ranges::find(layout.fields, property.name, &PlyRecordLayout::Field::name);
        // The first n_rest names f_rest_... have the SH functions 1 to n_rest (index) of
        // the first colour. The next names belong to the second colour.
        const bool is_other_colour = property.name.starts_with("f_rest_") && property.index > n_rest;
        if (field == layout.fields.end() || is_other_colour) {
            columns.missing.push_back(property);
            continue;
        }
        if (!field->is_float) fail("property {} has another type, expected float", property.name);
        columns.present.push_back({property, field->offset});
    }
    return columns;
}

/// @throws DataError if properties are missing that no other surfels can supply
void check_restorable(const PlyColumns& columns, const Scene& run_scene, SurfelParameterSet parameters) {
    for (const PlyProperty& p : columns.missing)
        if (p.group == &kMean || columns.missing.front().kind == PlyProperty::model ||
            run_scene.surfels.size() == 0 || run_scene.surfels.parameters_used() != parameters)
            fail("property {} is missing, expected all properties that `relidar export` writes", p.name);
}

void check_value(float value, const PlyProperty& property, std::size_t vertex_index, std::size_t n_models) {
    if (!std::isfinite(value))
        fail("vertex {}: {} is {}, expected a finite number", vertex_index, property.name, value);
    if (property.kind == PlyProperty::model &&
        (value < 0.0f || value != std::floor(value) || value >= float(n_models)))
        fail("vertex {}: the property \"model\" is {}, expected a whole number below {}", vertex_index, value,
             n_models);
}

std::vector<std::uint32_t> list_models(const Scene& scene) {
    std::vector<std::uint32_t> model(scene.surfels.size());
    for (std::size_t k = 0; k < scene.models.size(); ++k)
        std::fill_n(model.begin() + scene.models[k].first, scene.models[k].count, std::uint32_t(k));
    return model;
}

/// Finds the surfels of a run that surfels of an edited file come from.
class SurfelMatcher {
public:
    /// @param models  model of each surfel of the run
    SurfelMatcher(const Surfels& surfels, const std::vector<std::uint32_t>& models)
        : run_(surfels), run_model_(models), used_(surfels.size()) {
        for (std::uint32_t i = 0; i < run_.size(); ++i) cells_.emplace(key_of(run_.mean[i]), i);
    }

    /// Returns the index in the run of the surfel that surfel i of a file comes from. Of
    /// several surfels at its position, returns the most similar unused one.
    std::optional<std::uint32_t> find_match(const Surfels& surfels, std::size_t i) {
        std::optional<Candidate> best;
        bool has_twin = false;  // true if a surfel of another model fits equally well
        for (const std::uint64_t key : cells_around(surfels.mean[i])) {
            const auto [first, last] = cells_.equal_range(key);
            for (auto cell = first; cell != last; ++cell) {
                const std::uint32_t k = cell->second;
                const float distance_m = glm::distance(run_.mean[k], surfels.mean[i]);
                if (!(distance_m <= kSamePosition_m)) continue;
                const float difference = std::abs(run_.opacity_logit[k] - surfels.opacity_logit[i]) +
                                         glm::length(run_.log_scale[k] - surfels.log_scale[i]);
                const Candidate found{distance_m, difference, used_[k], k};
                const bool is_tie = best && best->distance_m == distance_m && best->difference == difference;
                if (is_tie && run_model_[best->surfel] != run_model_[k]) has_twin = true;
                if (!best || found < *best) {
                    if (!is_tie) has_twin = false;
                    best = found;
                }
            }
        }
        if (!best) return {};
        if (has_twin) ++n_twins_;
        used_[best->surfel] = true;
        return best->surfel;
    }
    std::size_t count_unused() const { return std::size_t(std::ranges::count(used_, false)); }
    std::size_t count_twins() const { return n_twins_; }  ///< surfels that fit several models

private:
    // Editors may round positions. Neighbouring surfels are farther apart.
    static constexpr float kSamePosition_m = 1e-3f;
    /// Surfel of the run. The order prefers the nearest, then the most similar, then one
    /// that is not used yet.
    struct Candidate {
        float distance_m, difference;  ///< difference of opacity and scales
        bool is_used;
        std::uint32_t surfel;
        auto operator<=>(const Candidate&) const = default;
    };
    /// Returns the keys of the cells that the sphere of matching positions touches.
    static std::set<std::uint64_t> cells_around(const glm::vec3& mean_m) {
        std::set<std::uint64_t> keys;
        for (const float x : {-kSamePosition_m, kSamePosition_m})
            for (const float y : {-kSamePosition_m, kSamePosition_m})
                for (const float z : {-kSamePosition_m, kSamePosition_m})
                    keys.insert(key_of(mean_m + glm::vec3(x, y, z)));
        return keys;
    }
    static std::uint64_t key_of(const glm::vec3& mean_m) {
        return grid_key(glm::clamp(glm::dvec3(mean_m), -1e6, 1e6), 0.05);
    }
    const Surfels& run_;
    const std::vector<std::uint32_t>& run_model_;
    std::vector<bool> used_;
    std::size_t n_twins_ = 0;
    std::unordered_multimap<std::uint64_t, std::uint32_t> cells_;
};

/// Sets the properties that a PLY file lacks to those of the run's surfels at the same
/// positions.
/// @param model output: model of each surfel, if the file lacks it
/// @return a note about the surfels that were matched
/// @throws DataError if a surfel was moved, or if its model is ambiguous
std::string restore_columns(Surfels& surfels, std::vector<std::uint32_t>& model, const PlyColumns& columns,
                            const Scene& scene) {
    const std::vector<std::uint32_t> run_model = list_models(scene);
    SurfelMatcher matcher(scene.surfels, run_model);
    std::size_t n_moved = 0, first_moved = 0;  // surfels that match no surfel of the run
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        const std::optional<std::uint32_t> match = matcher.find_match(surfels, i);
        if (!match) {
            if (n_moved == 0) first_moved = i;
            ++n_moved;
            continue;
        }
        for (const PlyProperty& p : columns.missing) {
            if (p.kind == PlyProperty::model) model[i] = run_model[*match];
            else p.value_in(surfels, i) = p.value_in(scene.surfels, *match);
        }
    }
    if (n_moved > 0) {
        const glm::vec3& at = surfels.mean[first_moved];
        float nearest_m = std::numeric_limits<float>::infinity();
        for (const glm::vec3& mean : scene.surfels.mean)
            nearest_m = std::min(nearest_m, glm::distance(mean, at));
        fail(
            "the property {} is missing, and {} of {} surfels are not at the position of a surfel of the run "
            "(vertex {} is {:.3g} m from the nearest one); expected surfels that were not moved, or all "
            "properties that `relidar export` writes",
            columns.missing.front().name, n_moved, surfels.size(), first_moved, nearest_m);
    }
    // The model is the last property. Twins fit surfels of several models. They need no
    // choice if the file has all surfels of the run, because each is then used once.
    if (columns.missing.back().kind == PlyProperty::model && matcher.count_twins() > 0 &&
        matcher.count_unused() > 0)
        fail(
            "the property model is missing, {} surfels fit several models of the run, and {} surfels of the "
            "run are not in the file; expected the property model",
            matcher.count_twins(), matcher.count_unused());
    return fmt::format(
        "the file lacks {} properties, such as {}; they are those of the run's surfels at the same "
        "positions; {} of {} surfels of the run are not in the file",
        columns.missing.size(), columns.missing.front().name, matcher.count_unused(), scene.surfels.size());
}

/// Makes a scene from the surfels of a file. Sorts the surfels by model, and keeps the
/// order of the file within each model.
Scene group_by_model(const Surfels& surfels, const std::vector<std::uint32_t>& models, const Scene& layout) {
    std::vector<std::uint32_t> order(models.size());
    std::iota(order.begin(), order.end(), 0u);
    std::stable_sort(order.begin(), order.end(), [&](std::uint32_t first, std::uint32_t second) {
        return models[first] < models[second];
    });
    Scene scene = strip_surfels(layout);
    scene.surfels = surfels.reorder(order);
    std::uint32_t first = 0;
    for (std::size_t k = 0; k < scene.models.size(); ++k) {
        const auto count = static_cast<std::uint32_t>(
            std::count(models.begin(), models.end(), static_cast<std::uint32_t>(k)));
        scene.models[k].first = first;
        scene.models[k].count = count;
        first += count;
    }
    return scene;
}

/// Parses a PLY file to a scene with the models and instances of `run_scene`, whose
/// surfels supply missing properties. Vertices can have any order.
/// @param note output: says which properties were copied from the run
Scene parse_ply(const std::string& bytes, const Scene& run_scene, SurfelParameterSet parameters,
                std::string& note) {
    // The lines of the header end with LF or CR LF. If one form is missing, its find()
    // returns npos, the largest number. One record per vertex follows the header.
    const std::string start = bytes.substr(0, kMaxPlyHeader);
    const std::size_t header_end = std::min(start.find("\nend_header\n"), start.find("\nend_header\r\n"));
    if (!start.starts_with("ply")) throw DataError("the file does not begin with \"ply\"");
    if (header_end == std::string::npos) fail("end_header is missing in the first {} bytes", start.size());
    const PlyRecordLayout layout = parse_ply_header(start.substr(0, header_end));
    const PlyColumns columns = find_columns(layout, parameters);
    check_restorable(columns, run_scene, parameters);
    const std::string_view records = std::string_view(bytes).substr(start.find('\n', header_end + 1) + 1);
    if (records.size() / layout.stride != layout.count || records.size() % layout.stride != 0)
        fail("found {} bytes of data, expected {} vertices of {} bytes", records.size(), layout.count,
             layout.stride);
    Surfels surfels;
    surfels.resize(layout.count, parameters);
    std::vector<std::uint32_t> model(layout.count);
    for (std::size_t i = 0; i < layout.count; ++i)
        for (const auto& [property, offset] : columns.present) {
            float value;
            std::memcpy(&value, records.data() + i * layout.stride + offset, sizeof value);
            check_value(value, property, i, run_scene.models.size());
            if (property.kind == PlyProperty::model) model[i] = static_cast<std::uint32_t>(value);
            else property.value_in(surfels, i) = value;
        }
    if (!columns.missing.empty()) note = restore_columns(surfels, model, columns, run_scene);
    return group_by_model(surfels, model, run_scene);
}

/// Returns the header of a PLY file.
/// @param frame name of the coordinate frame of the positions, for a comment line
std::string make_header(const Surfels& surfels, const std::vector<PlyProperty>& properties, const char* frame,
                        const FileMetadata& notes = {}) {
    std::string text = "ply\nformat binary_little_endian 1.0\ncomment relidar ";
    const PrimitiveProperties& kind = properties_of(surfels.primitive);
    text += fmt::format("{}: metres, {}{}\n", kind.label, frame,
                        kind.third_scale ? "" : "; scale_2 only makes them flat");
    for (const auto& note : notes) text += fmt::format("comment {}\n", codecs::metadata_line(note));
    text += fmt::format("element vertex {}\n", surfels.size());
    for (const PlyProperty& p : properties) text += fmt::format("property float {}\n", p.name);
    return text + "end_header\n";
}

/// Writes the surfels of `models`, in the order of the models.
void write_file(const fs::path& path, const Surfels& surfels, const std::vector<SurfelModel>& models,
                const std::vector<PlyProperty>& properties, const std::string& header) {
    write_atomically(path, [&](const fs::path& temporary) {
        surfels.check_lengths();
        codecs::OutputFile file(temporary);
        file.write(header);
        std::vector<float> record(properties.size());
        for (std::size_t model = 0; model < models.size(); ++model)
            for (std::size_t i = models[model].first, end = i + models[model].count; i < end; ++i) {
                for (std::size_t k = 0; k < properties.size(); ++k)
                    record[k] = property_value(properties[k], surfels, i, model);
                file.write(record.data(), record.size() * sizeof(float));
            }
        file.close();
    });
}

}  // namespace

void write_surfels(const fs::path& path, const Scene& scene, const FileMetadata& comments) {
    check_layout(scene);
    const std::vector<PlyProperty> list = list_properties(scene.surfels.parameters_used());
    write_file(path, scene.surfels, scene.models, list,
               make_header(scene.surfels, list, "frame of each model", comments));
}

void write_surfels(const fs::path& path, const Surfels& surfels, const FileMetadata& comments) {
    std::vector<PlyProperty> list = list_properties(surfels.parameters_used());
    list.pop_back();  // the model
    write_file(path, surfels, {{"", 0, static_cast<std::uint32_t>(surfels.size())}}, list,
               make_header(surfels, list, "world", comments));
}

Scene read_surfel_ply(const fs::path& path, const Scene& layout, PrimitiveType primitive, std::string* note) {
    std::string ignored_note;
    const std::string file = read_file(path);
    try {
        const bool walks = std::ranges::any_of(
            layout.models, [](const SurfelModel& model) { return model.stride_m > 0.0f; });
        return parse_ply(file, layout, {primitive, walks}, note ? *note : ignored_note);
    } catch (const DataError& error) {
        fail("cannot read PLY '{}': {}", path.string(), error.what());
    }
}

}  // namespace relidar
