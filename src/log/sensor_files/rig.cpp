// SPDX-License-Identifier: Apache-2.0
// Reads sensor rigs. A rig is a set of sensors with their poses on the vehicle.
// Intersects rays with the body of the vehicle.
#include <relidar/log/own_vehicle.hpp>
#include <relidar/log/sensor_files.hpp>

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/geometry/ray_box.hpp"
#include "base/json_field.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr std::size_t kMostSensors = 64;
constexpr double kMinLength_m = 0.001, kMaxOffset_m = 1000.0;

void check_count(const JsonField& list) {
    if (list.size() == 0 || list.size() > kMostSensors)
        list.reject(fmt::format("found {} entries", list.size()),
                    fmt::format("expected 1 to {}", kMostSensors));
}

/// Returns zeros if the key is missing.
glm::dvec3 read_vector(const JsonField& object, const char* key, double max_abs_value) {
    return object.has_member(key) ? object.at(key).vector_in(-max_abs_value, max_abs_value) : glm::dvec3(0.0);
}

/// Returns a sensor of a rig.
/// @param sensor  the name of a sensor, the name of a file, or an object
SensorModel read_rig_sensor(const JsonField& sensor, const std::string& sensor_name,
                            const std::string& rig_file) {
    if (!sensor.is_string()) {
        SensorModel model = sensor_files::read_json_sensor(sensor, sensor_name);
        sensor_files::set_missing_range(model, kDefaultMaxRange_m, sensor.location());
        return model;
    }
    const std::string name_or_file = sensor.text();
    if (find_name(name_or_file, list_sensors())) return find_sensor(name_or_file);
    // A file in the folder of the rig, which ":1024x10" may follow, or another path.
    const fs::path path = fs::path(rig_file).parent_path() / name_or_file;
    const fs::path without_columns = path.string().substr(0, path.string().rfind(':'));
    const bool is_in_folder = does_path_exist(path) || does_path_exist(without_columns);
    return find_sensor(is_in_folder ? path.string() : name_or_file);
}

/// Reads and checks the name of a sensor. Folders get the names of sensors, so names must
/// be unique and valid in a path.
std::string read_sensor_name(const JsonField& name_field, const std::vector<MountedSensor>& others) {
    const std::string name = name_field.text();
    const auto allowed = [](unsigned char character) {
        return std::isalnum(character) || character == '-' || character == '_' || character == '.';
    };
    if (name.empty() || name.size() > 64 || name.starts_with('.') || !std::ranges::all_of(name, allowed))
        name_field.reject(fmt::format("found \"{}\"", quote(name)),
                          "expected at most 64 letters, digits, -, _ and .");
    if (std::ranges::find(others, name, &MountedSensor::name) != others.end())
        name_field.reject(fmt::format("\"{}\" occurs twice", name), "expected it once");
    return name;
}

/// Reads a box of the vehicle. Its centre is relative to the ground below the rear axle.
VehicleBox parse_vehicle_box(const JsonField& box) {
    box.check_members({"centre_m", "size_m"});
    const JsonField size = box.at("size_m");
    const glm::dvec3 size_m = size.vector_in(-kMaxOffset_m, kMaxOffset_m);
    if (!(std::min({size_m.x, size_m.y, size_m.z}) > 0.0))
        size.reject("found a number that is not above 0", "expected three numbers above 0");
    return {.frame_from_box = {.translation = read_vector(box, "centre_m", kMaxOffset_m)}, .size_m = size_m};
}

/// Reads the body of the vehicle, which blocks rays. By default, it is one box.
OwnVehicle parse_vehicle(const Json& json, const JsonField& field) {
    field.check_members(
        {"length_m", "width_m", "height_m", "rear_axle_to_front_m", "base_link_m", "boxes", "points"});
    const auto read_length_m = [&](const char* key) {
        return field.at(key).number_in(kMinLength_m, kMaxOffset_m);
    };
    const double length_m = read_length_m("length_m"), width_m = read_length_m("width_m"),
                 height_m = read_length_m("height_m"), front_m = read_length_m("rear_axle_to_front_m");
    OwnVehicle vehicle{.json = json.dump()};
    vehicle.rig_from_base_link.translation = read_vector(field, "base_link_m", kMaxOffset_m);
    const std::string points = field.has_member("points") ? field.at("points").text() : "drop";
    if (points != "drop" && points != "ego")
        field.at("points").reject(fmt::format("found \"{}\"", quote(points)), "expected drop or ego");
    vehicle.keeps_points = points == "ego";  // "drop" leaves out the points of the vehicle
    if (field.has_member("boxes")) {
        check_count(field.at("boxes"));
        vehicle.boxes = field.at("boxes").list(parse_vehicle_box);
    } else {
        // The origin is on the ground below the rear axle, so the centre is half a length
        // behind the front and half a height above the ground.
        const glm::dvec3 centre_m(front_m - 0.5 * length_m, 0.0, 0.5 * height_m);
        vehicle.boxes = {
            {.frame_from_box = {.translation = centre_m}, .size_m = {length_m, width_m, height_m}}};
    }
    return vehicle;
}

/// Reads the JSON object of a rig. Returns null if the file cannot be read or is not a
/// rig, because the path may be a sensor, for which find_sensor() reports errors.
Json read_rig_json(const std::string& path) {
    if (fs::path(path).extension() != ".json") return {};
    Json json;
    try {
        json = Json::parse(read_text_file(path));
    } catch (const std::exception&) {
        return {};
    }
    if (!json.is_object() || !json.contains("sensors")) return {};
    JsonField(json, path, "").check_members({"sensors", "vehicle"});
    return json;
}

}  // namespace

std::optional<OwnVehicle> read_rig_vehicle(const std::string& path) {
    const Json json = read_rig_json(path);
    const JsonField root(json, path, "");
    if (!root.has_member("vehicle")) return {};
    if (json.at("vehicle") == kVehicleOfLog) return OwnVehicle{.is_of_log = true};
    return parse_vehicle(json.at("vehicle"), root.at("vehicle"));
}

std::optional<std::vector<MountedSensor>> read_sensor_rig(const std::string& path) {
    const Json json = read_rig_json(path);
    if (json.is_null()) return {};
    const std::optional<OwnVehicle> vehicle = read_rig_vehicle(path);
    const JsonField sensors = JsonField(json, path, "").at("sensors");
    check_count(sensors);
    std::vector<MountedSensor> rig;
    for (std::size_t i = 0; i < sensors.size(); ++i) {
        const JsonField sensor = sensors.at(i);
        sensor.check_members({"name", "sensor", "translation_m", "yaw_pitch_roll_deg", "returns"});
        const std::string name = read_sensor_name(sensor.at("name"), rig);
        SensorModel model = read_rig_sensor(sensor.at("sensor"), name, path);
        const glm::dvec3 angle_rad = read_vector(sensor, "yaw_pitch_roll_deg", 360.0) * (kPi / 180.0);
        const Pose rig_from_sensor{make_rotation(angle_rad.x, angle_rad.y, angle_rad.z),
                                   read_vector(sensor, "translation_m", kMaxOffset_m)};
        const auto returns = sensor.has_member("returns") ? sensor.at("returns").integer_in(1, 2) : 1;
        VehicleBody body;
        if (vehicle) body = place_body(*vehicle, rig_from_sensor);
        rig.push_back({name, std::move(model), rig_from_sensor, int(returns), std::move(body)});
    }
    return rig;
}

VehicleBody place_body(const OwnVehicle& vehicle, const Pose& rig_from_sensor) {
    VehicleBody body{{}, vehicle.keeps_points};
    for (const VehicleBox& box : vehicle.boxes)
        body.boxes.push_back(
            {inverse(rig_from_sensor) * vehicle.rig_from_base_link * box.frame_from_box, box.size_m});
    return body;
}

std::optional<BodyHit> find_body_hit(std::span<const VehicleBox> boxes, const glm::dvec3& origin_m,
                                     const glm::dvec3& direction) {
    std::optional<BodyHit> nearest;
    for (const VehicleBox& box : boxes) {
        const glm::dvec3 origin_in_box = inverse(box.frame_from_box) * origin_m,
                         direction_in_box = glm::conjugate(box.frame_from_box.rotation) * direction;
        const auto crossing = cross_box(origin_in_box, direction_in_box, -0.5 * box.size_m, 0.5 * box.size_m);
        // A ray that starts in the box or behind it does not enter it ahead.
        if (!crossing || crossing->enter <= 0.0) continue;
        if (nearest && nearest->range_m <= crossing->enter) continue;
        // The normal of the crossed side points against the ray.
        glm::dvec3 normal_in_box(0.0);
        normal_in_box[crossing->axis] = -std::copysign(1.0, direction_in_box[crossing->axis]);
        nearest = BodyHit{crossing->enter, box.frame_from_box.rotation * normal_in_box};
    }
    return nearest;
}

}  // namespace relidar
