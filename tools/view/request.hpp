// SPDX-License-Identifier: Apache-2.0
// Requests of the page, as JSON texts on the WebSocket:
//   {"do": "scan", "id": 7, "time_s": 1.5, "place": [x, y, z, yaw_deg, pitch_deg, roll_deg],
//    "sensor": "VLP-16", "lidar": 0, "weather": "fog=50", "simulate": true, "real": false,
//    "edits": EDITS}
//   {"do": "sensor", "file": "beams.csv", "text": "..."}      defines the sensor named "file"
//   {"do": "ground", "of": TRACK, "from": RUN, "at": [x, y]}  asks for a copy's pose on the ground
//   {"do": "save", "name": "run2", "edits": EDITS}
// EDITS: {"copies": [{"of": TRACK, "from": RUN, "at": [x, y, z, yaw_deg, pitch_deg,
// roll_deg, speed_mps]}], "moves": {TRACK: [x, y, z, yaw_deg]}, "removed": [TRACK],
// "hidden": [TRACK]}. RUN is "" or another run of the message `hello`. Places are in
// relidar's world frame, moves in the actor's frame. Requests are untrusted input, so
// this file checks every value.
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

/// Edits of the actors in a run. They are applied in this order: copies, moves, removals.
struct ActorEdits {
    struct Copy {
        std::string of;
        /// Name of the run that contains the actor. If it is empty, the displayed run
        /// contains it.
        std::string from;
        /// Position x, y, z in relidar's world frame (metres), then yaw, pitch and roll
        /// (degrees), then forward speed (m/s).
        std::array<double, 7> at{};
        bool operator==(const Copy&) const = default;
    };
    std::vector<Copy> copies;
    /// Move of each actor by track: forward, left and up in the actor's frame (metres),
    /// and yaw (degrees).
    std::map<std::string, std::array<double, 4>> moves;
    std::set<std::string> removed;
    std::set<std::string> hidden;  ///< Actors that only the view hides. A saved run still contains them.
    bool operator==(const ActorEdits&) const = default;
};

struct LiveScanRequest {
    std::int64_t id = 0;  ///< Number of the request. The answer contains the same number.
    double time_s = 0.0;
    Pose sensor_offset;  ///< Pose of the simulated sensor relative to the LiDAR of the log.
    std::string sensor = "native";
    int lidar = 0;
    Weather weather = {};
    bool simulate = true;
    bool real = false;  ///< If true, the log's scan that is nearest in time is sent as well.
    ActorEdits edits;
};

struct SensorFile {
    /// Name of the file on the user's machine. It appears in messages, and its extension
    /// selects the format.
    std::string name;
    std::string text;
};

/// Asks for the pose of an actor on the ground at the position that the user clicked.
struct GroundRequest {
    std::string of;
    std::string from;            ///< See ActorEdits::Copy.
    std::array<double, 2> at{};  ///< Clicked position x and y in relidar's world frame.
};

struct SaveRequest {
    std::string name;  ///< Name of the new folder. It may contain only letters, digits, -, _ and .
    ActorEdits edits;
};

using Request = std::variant<LiveScanRequest, SensorFile, SaveRequest, GroundRequest>;

/// Parses a request of the page.
/// @throws UsageError that names the first value that is missing, has a wrong type, or is
/// out of bounds
Request parse_request(const std::string& text);

}  // namespace relidar::view
