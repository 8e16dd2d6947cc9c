// SPDX-License-Identifier: Apache-2.0
#include "request.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>

namespace relidar::view {
namespace {

using Json = nlohmann::json;

// Maximum absolute value of a position or move. Larger values are rejected with an error.
constexpr double kFar_m = 10'000.0;
constexpr double kFarAway_m = 1e6;  // Maximum absolute value of a position in relidar's world frame.
constexpr double kFast_mps = 200.0;
constexpr double kLate_s = 1e10;
// Maximum number of actors that a request may copy, move, remove or hide.
constexpr std::size_t kMaxActors = 256;
constexpr std::size_t kMaxName = 64;
// Maximum length of the name of a run. The name is the path that the user typed after
// `relidar view`.
constexpr std::size_t kMaxRunName = 1024;

[[noreturn]] void throw_request_error(const std::string& description, const std::string& expected) {
    throw UsageError(fmt::format("{}: expected {}", description, expected));
}

const Json& get_member(const Json& object, const char* name) {
    const auto member = object.find(name);
    if (member == object.end()) throw_request_error(name, "this member in the message");
    return *member;
}

double read_limited_number(const Json& value, const std::string& description, double limit) {
    if (!value.is_number()) throw_request_error(description, "a number");
    const double x = value.get<double>();
    if (!(std::abs(x) <= limit))
        throw_request_error(description, fmt::format("a number from -{0} to {0}", limit));
    return x;
}

bool read_flag(const Json& value, const char* description) {
    if (!value.is_boolean()) throw_request_error(description, "true or false");
    return value.get<bool>();
}

std::string read_request_text(const Json& value, const char* description, std::size_t limit = kMaxName) {
    if (!value.is_string()) throw_request_error(description, "a text");
    std::string result = value.get<std::string>();
    if (result.empty() || result.size() > limit)
        throw_request_error(description, fmt::format("a text of 1 to {} bytes", limit));
    return result;
}

/// Returns the name of the run that contains an actor. An empty name means the run that
/// the viewer shows.
std::string read_run_name(const Json& value) {
    return value == "" ? "" : read_request_text(value, "from", kMaxRunName);
}

/// Reads an array of N numbers. Number i must not exceed limits[i] in absolute value.
template <std::size_t N>
std::array<double, N> read_number_array(const Json& value, const char* description,
                                        const std::array<double, N>& limits) {
    if (!value.is_array() || value.size() != N)
        throw_request_error(description, fmt::format("{} numbers", N));
    std::array<double, N> result;
    for (std::size_t i = 0; i < N; ++i)
        result[i] = read_limited_number(value[i], fmt::format("{} {}", description, i + 1), limits[i]);
    return result;
}

std::set<std::string> read_track_names(const Json& value, const char* description) {
    if (!value.is_array() || value.size() > kMaxActors)
        throw_request_error(description, fmt::format("a list of at most {} tracks", kMaxActors));
    std::set<std::string> result;
    for (const Json& track : value) result.insert(read_request_text(track, description));
    return result;
}

ActorEdits parse_edits(const Json& json) {
    if (!json.is_object()) throw_request_error("edits", "an object");
    ActorEdits edits;
    const Json& copies = get_member(json, "copies");
    if (!copies.is_array() || copies.size() > kMaxActors)
        throw_request_error("copies", fmt::format("a list of at most {} copies", kMaxActors));
    for (const Json& copy : copies) {
        if (!copy.is_object()) throw_request_error("copies", "objects");
        edits.copies.push_back(
            {read_request_text(get_member(copy, "of"), "of"), read_run_name(get_member(copy, "from")),
             read_number_array<7>(get_member(copy, "at"), "at",
                                  {kFarAway_m, kFarAway_m, kFarAway_m, 360.0, 360.0, 360.0, kFast_mps})});
    }
    const Json& moves = get_member(json, "moves");
    if (!moves.is_object() || moves.size() > kMaxActors)
        throw_request_error("moves", fmt::format("an object of at most {} tracks", kMaxActors));
    for (const auto& [track, by] : moves.items())
        edits.moves[track] = read_number_array<4>(by, "moves", {kFar_m, kFar_m, kFar_m, 360.0});
    edits.removed = read_track_names(get_member(json, "removed"), "removed");
    edits.hidden = read_track_names(get_member(json, "hidden"), "hidden");
    return edits;
}

LiveScanRequest parse_scan(const Json& json) {
    const auto place = read_number_array<6>(get_member(json, "place"), "place",
                                            {kFar_m, kFar_m, kFar_m, 360.0, 360.0, 360.0});
    const double radians = kPi / 180.0;
    LiveScanRequest wish;
    wish.id = static_cast<std::int64_t>(read_limited_number(get_member(json, "id"), "id", 1e15));
    wish.time_s = read_limited_number(get_member(json, "time_s"), "time_s", kLate_s);
    wish.sensor_offset = {make_rotation(place[3] * radians, place[4] * radians, place[5] * radians),
                          {place[0], place[1], place[2]}};
    wish.sensor = read_request_text(get_member(json, "sensor"), "sensor");
    wish.lidar = static_cast<int>(read_limited_number(get_member(json, "lidar"), "lidar", 1000.0));
    wish.weather = parse_weather(read_request_text(get_member(json, "weather"), "weather"));
    wish.simulate = read_flag(get_member(json, "simulate"), "simulate");
    wish.real = read_flag(get_member(json, "real"), "real");
    wish.edits = parse_edits(get_member(json, "edits"));
    return wish;
}

/// Reads the name of a new folder. Rejects a name that contains a path, so that the
/// folder cannot be created elsewhere.
std::string get_folder_name(const Json& value) {
    std::string name = read_request_text(value, "name");
    const auto plain = [](char character) {
        return (character >= 'a' && character <= 'z') || (character >= 'A' && character <= 'Z') ||
               (character >= '0' && character <= '9') || character == '-' || character == '_' ||
               character == '.';
    };
    if (!std::all_of(name.begin(), name.end(), plain) || name.front() == '.' || name.front() == '-')
        throw_request_error(
            "name",
            "a name that starts with a letter or digit and contains only letters, digits, -, _ and .");
    return name;
}

}  // namespace

Request parse_request(const std::string& message) {
    const Json json = Json::parse(message, nullptr, false);
    if (!json.is_object()) throw UsageError("cannot read a message of the page: expected a JSON object");
    const std::string kind = read_request_text(get_member(json, "do"), "do");
    if (kind == "scan") return parse_scan(json);
    if (kind == "sensor")
        return SensorFile{read_request_text(get_member(json, "file"), "file", 200),
                          read_request_text(get_member(json, "text"), "text", message.size())};
    if (kind == "save")
        return SaveRequest{get_folder_name(get_member(json, "name")), parse_edits(get_member(json, "edits"))};
    if (kind == "ground")
        return GroundRequest{read_request_text(get_member(json, "of"), "of"),
                             read_run_name(get_member(json, "from")),
                             read_number_array<2>(get_member(json, "at"), "at", {kFarAway_m, kFarAway_m})};
    throw UsageError(fmt::format("do: found \"{}\", expected scan, sensor, ground or save", kind));
}

}  // namespace relidar::view
