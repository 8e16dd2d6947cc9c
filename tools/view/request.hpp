// SPDX-License-Identifier: Apache-2.0
// Parses the requests of the web page. They are JSON texts on the WebSocket:
//   {"do": "scan", "id": 7, "time_s": 1.5, "place": [x, y, z, yaw_deg, pitch_deg, roll_deg],
//    "sensor": "VLP-16", "lidar": 0, "weather": "fog=50", "simulate": true, "real": false,
//    "edits": EDITS}
//   {"do": "sensor", "file": "beams.csv", "text": "..."}      defines the sensor named "file"
//   {"do": "ground", "of": TRACK, "from": RUN, "at": [x, y]}  asks for a copy's pose on the ground
//   {"do": "save", "name": "run2", "edits": EDITS}
// EDITS: {"copies": [{"of": TRACK, "from": RUN, "at": [x, y, z, yaw_deg, pitch_deg,
// roll_deg, speed_mps]}], "moves": {TRACK: [x, y, z, yaw_deg]}, "removed": [TRACK],
// "hidden": [TRACK]}. RUN is "" or another run of the message `hello`. Positions are in
// relidar's world frame. Moves are in the actor's frame. Every value is checked, because
// clients may send invalid values.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <variant>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar::view {

/// Applied in this order: copies, moves, removals.
struct ActorEdits {
    struct ActorCopy {
        std::string of;
        /// Run of the actor to copy. Empty for the run that the viewer shows.
        std::string from;
        /// x, y, z in relidar's world frame (m); yaw, pitch, roll (degrees); speed (m/s).
        std::array<double, 7> at{};
        bool operator==(const ActorCopy&) const = default;
    };
    std::vector<ActorCopy> copies;
    /// By track: forward, left and up in the actor's frame (m), and yaw (degrees).
    std::map<std::string, std::array<double, 4>> moves;
    std::set<std::string> removed;
    /// Actors that are hidden only in the view. A saved run still contains these actors.
    std::set<std::string> hidden;
    bool operator==(const ActorEdits&) const = default;
};

struct LiveScanRequest {
    std::int64_t id = 0;  ///< Number of the request. The response contains the same number.
    double time_s = 0.0;
    Pose sensor_offset;  ///< Pose of the simulated sensor relative to the LiDAR of the log.
    std::string sensor = "native";
    int lidar = 0;
    Weather weather = {};
    bool simulate = true;
    bool real = false;
    ActorEdits edits;
};

struct SensorFile {
    /// On the user's machine. For error messages, and the extension is the format.
    std::string name;
    std::string text;
};

struct GroundPoseRequest {
    std::string of;
    std::string from;            ///< See ActorEdits::ActorCopy.
    std::array<double, 2> at{};  ///< Clicked position x and y in relidar's world frame.
};

struct SaveRequest {
    std::string name;  ///< Name of the new folder. It may contain only letters, digits, -, _ and dots.
    ActorEdits edits;
};

using BrowserRequest = std::variant<LiveScanRequest, SensorFile, SaveRequest, GroundPoseRequest>;

/// Parses a request of the web page and checks all values.
/// @throws UsageError that names the first invalid field
BrowserRequest parse_request(const std::string& request_json_text);

}  // namespace relidar::view
