// SPDX-License-Identifier: Apache-2.0
#include "request.hpp"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/fail.hpp"

namespace relidar::view {
namespace {

using Json = nlohmann::json;

constexpr double kMaxPosition_m = 10'000.0;
constexpr double kFarAway_m = 1e6;  // Maximum absolute value of a position in relidar's world frame.
constexpr double kMaxSpeed_mps = 200.0;
constexpr double kMaxTime_s = 1e10;
constexpr std::size_t kMaxActors = 256;
constexpr std::size_t kMaxName = 64;
// The name is the path that the user typed after `relidar view`.
constexpr std::size_t kMaxRunName = 1024;

[[noreturn]] void reject_request(const std::string& text, const std::string& expected) {
    fail<UsageError>("cannot read the field \"{}\" of the request: expected {}", text, expected);
}

const Json& member(const Json& object, const char* name) {
    const auto match = object.find(name);
    if (match == object.end()) reject_request(name, "a value, but the field is missing");
    return *match;
}

double number_within(const Json& value, const std::string& where, double max_absolute_value) {
    if (!value.is_number()) reject_request(where, "a number");
    const double x = value.get<double>();
    if (!(std::abs(x) <= max_absolute_value))
        reject_request(where, fmt::format("a number from -{0} to {0}", max_absolute_value));
    return x;
}

bool read_boolean(const Json& value, const char* where) {
    if (!value.is_boolean()) reject_request(where, "true or false");
    return value.get<bool>();
}

std::string read_text(const Json& value, const char* where, std::size_t max_bytes = kMaxName) {
    if (!value.is_string()) reject_request(where, "a text");
    std::string result = value.get<std::string>();
    if (result.empty() || result.size() > max_bytes)
        reject_request(where, fmt::format("a text of 1 to {} bytes", max_bytes));
    return result;
}

/// Reads the name of a run. It is empty for the run that the viewer shows.
std::string read_run_name(const Json& json) { return json == "" ? "" : read_text(json, "from", kMaxRunName); }

/// Reads a list of N numbers. `limits` has the largest absolute value of each.
template <std::size_t N>
std::array<double, N> read_numbers(const Json& value, const char* where,
                                   const std::array<double, N>& limits) {
    if (!value.is_array() || value.size() != N) reject_request(where, fmt::format("{} numbers", N));
    std::array<double, N> result;
    for (std::size_t i = 0; i < N; ++i)
        result[i] = number_within(value[i], fmt::format("{} {}", where, i + 1), limits[i]);
    return result;
}

std::set<std::string> read_track_names(const Json& value, const char* where) {
    if (!value.is_array() || value.size() > kMaxActors)
        reject_request(where, fmt::format("a list of at most {} tracks", kMaxActors));
    std::set<std::string> result;
    for (const Json& track : value) result.insert(read_text(track, where));
    return result;
}

/// Parses the user's changes of the actors. A copy has a pose and a speed: x, y, z in
/// metres; yaw, pitch, roll in degrees; m/s. A move has x, y, z and yaw.
ActorEdits parse_edits(const Json& json) {
    if (!json.is_object()) reject_request("edits", "a JSON object");
    ActorEdits edits;
    const Json& copies = member(json, "copies");
    if (!copies.is_array() || copies.size() > kMaxActors)
        reject_request("copies", fmt::format("a list of at most {} copies", kMaxActors));
    for (const Json& copy : copies) {
        if (!copy.is_object()) reject_request("copies", "a list of JSON objects");
        edits.copies.push_back(
            {read_text(member(copy, "of"), "of"), read_run_name(member(copy, "from")),
             read_numbers<7>(member(copy, "at"), "at",
                             {kFarAway_m, kFarAway_m, kFarAway_m, 360.0, 360.0, 360.0, kMaxSpeed_mps})});
    }
    const Json& moves = member(json, "moves");
    if (!moves.is_object() || moves.size() > kMaxActors)
        reject_request("moves", fmt::format("a JSON object with at most {} tracks", kMaxActors));
    for (const auto& [track, by] : moves.items())
        edits.moves[track] =
            read_numbers<4>(by, "moves", {kMaxPosition_m, kMaxPosition_m, kMaxPosition_m, 360.0});
    edits.removed = read_track_names(member(json, "removed"), "removed");
    edits.hidden = read_track_names(member(json, "hidden"), "hidden");
    return edits;
}

/// Parses a request for a scan. The field "place" is the sensor's offset from its
/// recorded pose: x, y, z in metres; yaw, pitch, roll in degrees.
LiveScanRequest parse_scan(const Json& json) {
    const auto place = read_numbers<6>(member(json, "place"), "place",
                                       {kMaxPosition_m, kMaxPosition_m, kMaxPosition_m, 360.0, 360.0, 360.0});
    constexpr double kRadians = kPi / 180.0;  // in a degree
    LiveScanRequest request;
    request.id = static_cast<std::int64_t>(number_within(member(json, "id"), "id", 1e15));
    request.time_s = number_within(member(json, "time_s"), "time_s", kMaxTime_s);
    request.sensor_offset = {make_rotation(place[3] * kRadians, place[4] * kRadians, place[5] * kRadians),
                             {place[0], place[1], place[2]}};
    request.sensor = read_text(member(json, "sensor"), "sensor");
    request.lidar = static_cast<int>(number_within(member(json, "lidar"), "lidar", 1000.0));
    request.weather = parse_weather(read_text(member(json, "weather"), "weather"));
    request.simulate = read_boolean(member(json, "simulate"), "simulate");
    request.real = read_boolean(member(json, "real"), "real");
    request.edits = parse_edits(member(json, "edits"));
    return request;
}

/// Reads the name of a new folder. Rejects a name that contains a path, so that the
/// folder cannot be created elsewhere.
std::string read_folder(const Json& value) {
    constexpr const char* kAllowedCharacters =
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.";
    std::string name = read_text(value, "name");
    const bool has_other_character = name.find_first_not_of(kAllowedCharacters) != std::string::npos;
    if (has_other_character || name.front() == '.' || name.front() == '-')
        reject_request(
            "name",
            "a name that starts with a letter or digit and contains only letters, digits, -, _ and .");
    return name;
}

}  // namespace

BrowserRequest parse_request(const std::string& text) {
    constexpr std::size_t kMaxFileName = 200;
    const Json json = Json::parse(text, nullptr, false);
    if (!json.is_object()) throw UsageError("cannot read the request: expected a JSON object");
    const std::string kind = read_text(member(json, "do"), "do");
    if (kind == "scan") return parse_scan(json);
    if (kind == "sensor")
        return SensorFile{.name = read_text(member(json, "file"), "file", kMaxFileName),
                          .text = read_text(member(json, "text"), "text", text.size())};
    if (kind == "save")
        return SaveRequest{.name = read_folder(member(json, "name")),
                           .edits = parse_edits(member(json, "edits"))};
    if (kind == "ground")
        return GroundPoseRequest{.of = read_text(member(json, "of"), "of"),
                                 .from = read_run_name(member(json, "from")),
                                 .at = read_numbers<2>(member(json, "at"), "at", {kFarAway_m, kFarAway_m})};
    fail<UsageError>(
        "cannot read the field \"do\" of the request: found \"{}\", expected scan, sensor, ground or save",
        kind);
}

}  // namespace relidar::view
