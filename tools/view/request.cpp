// SPDX-License-Identifier: Apache-2.0
#include "request.hpp"

#include <algorithm>
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

const Json& required_member(const Json& object, const char* member_name) {
    const auto member = object.find(member_name);
    if (member == object.end()) reject_request(member_name, "a value, but the field is missing");
    return *member;
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

std::string read_run_name(const Json& run_name_json) {
    return run_name_json == "" ? "" : read_text(run_name_json, "from", kMaxRunName);
}

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

ActorEdits parse_edits(const Json& edits_json) {
    if (!edits_json.is_object()) reject_request("edits", "a JSON object");
    ActorEdits edits;
    const Json& copies = required_member(edits_json, "copies");
    if (!copies.is_array() || copies.size() > kMaxActors)
        reject_request("copies", fmt::format("a list of at most {} copies", kMaxActors));
    for (const Json& copy : copies) {
        if (!copy.is_object()) reject_request("copies", "a list of JSON objects");
        edits.copies.push_back(
            {read_text(required_member(copy, "of"), "of"), read_run_name(required_member(copy, "from")),
             read_numbers<7>(required_member(copy, "at"), "at",
                             {kFarAway_m, kFarAway_m, kFarAway_m, 360.0, 360.0, 360.0, kMaxSpeed_mps})});
    }
    const Json& moves = required_member(edits_json, "moves");
    if (!moves.is_object() || moves.size() > kMaxActors)
        reject_request("moves", fmt::format("a JSON object with at most {} tracks", kMaxActors));
    for (const auto& [track, by] : moves.items())
        edits.moves[track] =
            read_numbers<4>(by, "moves", {kMaxPosition_m, kMaxPosition_m, kMaxPosition_m, 360.0});
    edits.removed = read_track_names(required_member(edits_json, "removed"), "removed");
    edits.hidden = read_track_names(required_member(edits_json, "hidden"), "hidden");
    return edits;
}

LiveScanRequest parse_scan(const Json& request_json) {
    const auto xyz_yaw_pitch_roll =
        read_numbers<6>(required_member(request_json, "place"), "place",
                        {kMaxPosition_m, kMaxPosition_m, kMaxPosition_m, 360.0, 360.0, 360.0});
    const double radians = kPi / 180.0;
    LiveScanRequest wish;
    wish.id = static_cast<std::int64_t>(number_within(required_member(request_json, "id"), "id", 1e15));
    wish.time_s = number_within(required_member(request_json, "time_s"), "time_s", kMaxTime_s);
    wish.sensor_offset = {make_rotation(xyz_yaw_pitch_roll[3] * radians, xyz_yaw_pitch_roll[4] * radians,
                                        xyz_yaw_pitch_roll[5] * radians),
                          {xyz_yaw_pitch_roll[0], xyz_yaw_pitch_roll[1], xyz_yaw_pitch_roll[2]}};
    wish.sensor = read_text(required_member(request_json, "sensor"), "sensor");
    wish.lidar = static_cast<int>(number_within(required_member(request_json, "lidar"), "lidar", 1000.0));
    wish.weather = parse_weather(read_text(required_member(request_json, "weather"), "weather"));
    wish.simulate = read_boolean(required_member(request_json, "simulate"), "simulate");
    wish.real = read_boolean(required_member(request_json, "real"), "real");
    wish.edits = parse_edits(required_member(request_json, "edits"));
    return wish;
}

/// Rejects a path, so that the folder cannot be created elsewhere.
std::string read_folder(const Json& value) {
    std::string name = read_text(value, "name");
    const auto plain = [](char character) {
        return (character >= 'a' && character <= 'z') || (character >= 'A' && character <= 'Z') ||
               (character >= '0' && character <= '9') || character == '-' || character == '_' ||
               character == '.';
    };
    if (!std::all_of(name.begin(), name.end(), plain) || name.front() == '.' || name.front() == '-')
        reject_request(
            "name",
            "a name that starts with a letter or digit and contains only letters, digits, -, _ and .");
    return name;
}

}  // namespace

BrowserRequest parse_request(const std::string& request_json_text) {
    const Json json = Json::parse(request_json_text, nullptr, false);
    if (!json.is_object()) throw UsageError("cannot read the request: expected a JSON object");
    const std::string kind = read_text(required_member(json, "do"), "do");
    if (kind == "scan") return parse_scan(json);
    if (kind == "sensor")
        return SensorFile{read_text(required_member(json, "file"), "file", 200),
                          read_text(required_member(json, "text"), "text", request_json_text.size())};
    if (kind == "save")
        return SaveRequest{read_folder(required_member(json, "name")),
                           parse_edits(required_member(json, "edits"))};
    if (kind == "ground")
        return GroundPoseRequest{
            read_text(required_member(json, "of"), "of"), read_run_name(required_member(json, "from")),
            read_numbers<2>(required_member(json, "at"), "at", {kFarAway_m, kFarAway_m})};
    fail<UsageError>(
        "cannot read the field \"do\" of the request: found \"{}\", expected scan, sensor, ground or save",
        kind);
}

}  // namespace relidar::view
