// SPDX-License-Identifier: Apache-2.0
// Reads sensor rigs. A rig is a set of sensors with their poses on the vehicle.
#include <relidar/log/sensor_files.hpp>

#include <algorithm>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr std::size_t kMostSensors = 64;
constexpr double kMaxOffset_m = 1000.0;

glm::dvec3 read_vector(const Json& json, const char* key, double max_abs_value, const std::string& place) {
    if (!json.contains(key)) return glm::dvec3(0.0);
    const Json& list = json.at(key);
    glm::dvec3 v(0.0);
    const bool numbers = list.is_array() && list.size() == 3 &&
                         std::all_of(list.begin(), list.end(), [](const Json& n) { return n.is_number(); });
    for (int k = 0; numbers && k < 3; ++k) v[k] = list[std::size_t(k)].get<double>();
    if (!numbers ||
        !(std::abs(v.x) <= max_abs_value && std::abs(v.y) <= max_abs_value && std::abs(v.z) <= max_abs_value))
        fail("{}: the value of {} is invalid, expected three numbers of at most {}", place, key,
             max_abs_value);
    return v;
}

std::string read_text(const Json& sensor_json, const char* key, const std::string& place) {
    if (!sensor_json.is_object() || !sensor_json.contains(key) || !sensor_json.at(key).is_string())
        fail("{}: the value of {} is missing or is not a text, expected a text", place, key);
    return sensor_json.at(key).get<std::string>();
}

/// Returns the sensor of one rig entry. The entry contains the name of a sensor, the name
/// of a file, or a JSON object.
SensorModel read_rig_sensor(const Json& sensor_json, const std::string& sensor_name,
                            const std::string& rig_file, const std::string& place) {
    if (!sensor_json.contains("sensor") || !sensor_json.at("sensor").is_object()) {
        // a file in the folder of the rig, a sensor name, or another path
        const std::string name_or_file = read_text(sensor_json, "sensor", place);
        const fs::path path = fs::path(rig_file).parent_path() / name_or_file;
        const fs::path without_columns = path.string().substr(0, path.string().rfind(':'));
        const bool is_beside_rig = !find_name(name_or_file, list_sensors()) &&
                                   (does_path_exist(path) || does_path_exist(without_columns));
        return find_sensor(is_beside_rig ? path.string() : name_or_file);
    }
    const std::string object = place + ": sensor";
    SensorModel model = parse_sensor(sensor_json.at("sensor").dump(), sensor_name, object);
    sensor_files::set_missing_range(model, kDefaultMaxRange_m, object);
    return model;
}

/// Folders get the names of sensors, so names must be unique and valid in a path.
void check_sensor_name(const std::string& name, const std::set<std::string>& used, const std::string& place) {
    const auto allowed = [](char character) {
        return std::isalnum(static_cast<unsigned char>(character)) || character == '-' || character == '_' ||
               character == '.';
    };
    if (name.empty() || name.size() > 64 || name.starts_with('.') ||
        !std::all_of(name.begin(), name.end(), allowed))
        fail("{}: name: found \"{}\", expected letters, digits, -, _ and .", place, quote(name));
    if (used.contains(name)) fail("{}: name: \"{}\" occurs twice, expected it once", place, name);
}

/// Throws for unknown keys. Otherwise a misspelt "translation" would mount the sensor at
/// the origin of the rig.
void check_keys(const Json& object, const std::vector<std::string>& known_keys, const std::string& place) {
    for (const auto& [key, value] : object.items())
        if (std::find(known_keys.begin(), known_keys.end(), key) == known_keys.end())
            fail("{}: unknown key '{}'{} (known: {})", place, quote(key), did_you_mean(key, known_keys, "'"),
                 fmt::join(known_keys, ", "));
}

double read_length(const Json& json, const char* key, const std::string& place) {
    const double length_m = json.contains(key) && json.at(key).is_number() ? json.at(key).get<double>() : 0.0;
    if (!(length_m > 0.0 && length_m <= kMaxOffset_m))
        fail("{}: the value of {} is invalid, expected a number above 0 and up to {}", place, key,
             kMaxOffset_m);
    return length_m;
}

OwnVehicle parse_vehicle(const Json& json, const std::string& place) {
    if (!json.is_object()) fail("{}: the value is not an object, expected an object", place);
    check_keys(json,
               {"length_m", "width_m", "height_m", "rear_axle_to_front_m", "base_link_m", "boxes", "points"},
               place);
    const double length_m = read_length(json, "length_m", place),
                 width_m = read_length(json, "width_m", place),
                 height_m = read_length(json, "height_m", place),
                 front_m = read_length(json, "rear_axle_to_front_m", place);
    OwnVehicle vehicle{.json = json.dump()};
    vehicle.rig_from_base_link.translation = read_vector(json, "base_link_m", kMaxOffset_m, place);
    const std::string points = json.contains("points") ? read_text(json, "points", place) : "drop";
    if (points != "drop" && points != "ego")
        fail("{}: points: found \"{}\", expected drop or ego", place, quote(points));
    vehicle.keeps_points = points == "ego";
    const auto add_box = [&](const glm::dvec3& centre_m, const glm::dvec3& size_m) {
        vehicle.boxes.push_back({{.translation = centre_m}, size_m});
    };
    const Json boxes = json.value("boxes", Json());
    // By default, one box on the ground. The origin is below the rear axle.
    if (boxes.is_null())
        add_box({front_m - 0.5 * length_m, 0.0, 0.5 * height_m}, {length_m, width_m, height_m});
    else if (!boxes.is_array() || boxes.empty() || boxes.size() > kMostSensors)
        fail("{}: boxes: expected a list with 1 to {} boxes", place, kMostSensors);
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        const std::string where = fmt::format("{}: box {}", place, i);
        if (!boxes[i].is_object()) fail("{}: the value is not an object, expected an object", where);
        check_keys(boxes[i], {"centre_m", "size_m"}, where);
        const glm::dvec3 size_m = read_vector(boxes[i], "size_m", kMaxOffset_m, where);
        if (!(std::min({size_m.x, size_m.y, size_m.z}) > 0.0))
            fail("{}: the value of size_m is invalid, expected three numbers above 0", where);
        add_box(read_vector(boxes[i], "centre_m", kMaxOffset_m, where), size_m);
    }
    return vehicle;
}

/// Returns null if the file is not a rig.
Json read_rig_json(const std::string& path) {
    if (fs::path(path).extension() != ".json") return {};
    Json json;
    try {
        json = Json::parse(read_text_file(path));
    } catch (const std::exception&) {
        // find_sensor() reports the error.
        return {};
    }
    if (!json.is_object() || !json.contains("sensors")) return {};
    check_keys(json, {"sensors", "vehicle"}, path);
    return json;
}

}  // namespace

std::optional<OwnVehicle> read_rig_vehicle(const std::string& path) {
    const Json json = read_rig_json(path);
    if (json.is_null() || !json.contains("vehicle")) return {};
    return parse_vehicle(json.at("vehicle"), path + ": vehicle");
}

std::optional<std::vector<MountedSensor>> read_sensor_rig(const std::string& path) {
    const Json json = read_rig_json(path);
    if (json.is_null()) return {};
    const std::optional<OwnVehicle> vehicle = read_rig_vehicle(path);
    if (!json.at("sensors").is_array() || json.at("sensors").empty() ||
        json.at("sensors").size() > kMostSensors)
        fail("{}: the key \"sensors\" is invalid, expected a list with 1 to {} entries", path, kMostSensors);
    std::vector<MountedSensor> rig;
    std::set<std::string> names;
    for (const Json& sensor : json.at("sensors")) {
        const std::string where = fmt::format("{}: sensor {}", path, rig.size());
        const std::string name = read_text(sensor, "name", where);
        check_sensor_name(name, names, where);
        names.insert(name);
        check_keys(sensor, {"name", "sensor", "translation_m", "yaw_pitch_roll_deg", "returns"}, where);
        SensorModel model = read_rig_sensor(sensor, name, path, where);
        const glm::dvec3 angle_rad = read_vector(sensor, "yaw_pitch_roll_deg", 360.0, where) * (kPi / 180.0);
        const Pose rig_from_sensor{make_rotation(angle_rad.x, angle_rad.y, angle_rad.z),
                                   read_vector(sensor, "translation_m", kMaxOffset_m, where)};
        const Json returns = sensor.contains("returns") ? sensor.at("returns") : Json(1);
        if (returns != 1 && returns != 2) fail("{}: the value of returns is invalid, expected 1 or 2", where);
        rig.push_back({name, std::move(model), rig_from_sensor, returns.get<int>(),
                       vehicle ? place_body(*vehicle, rig_from_sensor) : VehicleBody{}});
    }
    return rig;
}

}  // namespace relidar
