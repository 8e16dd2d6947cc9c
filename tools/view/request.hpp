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

/// Edits of the traffic. They take effect in this order: copies, moves, removals.
struct ActorEdits {
    struct Copy {
        std::string of;
        std::string from;  ///< Name of the run that contains the actor. Empty: the displayed run.
        /// x, y, z in relidar's world frame, yaw_deg, pitch_deg, roll_deg, and speed_mps
        /// straight ahead.
        std::array<double, 7> at{};
        bool operator==(const Copy&) const = default;
    };
    std::vector<Copy> copies;
    /// Forward, left, up and yaw_deg in the actor's frame.
    std::map<std::string, std::array<double, 4>> moves;
    std::set<std::string> removed;
    std::set<std::string> hidden;  ///< Hidden only in the view. Saved runs contain these actors.
    bool operator==(const ActorEdits&) const = default;
};

struct ScanWish {
    std::int64_t id = 0;  ///< The answer repeats this number.
    double time_s = 0.0;
    Pose sensor_offset;  ///< Pose of the sensor in the frame of the log's LiDAR.
    std::string sensor = "native";
    int lidar = 0;
    Weather weather = {};
    bool simulate = true;
    bool real = false;  ///< True: also send the log's scan that is nearest in time.
    ActorEdits edits;
};

struct SensorFile {
    std::string name;  ///< File name as uploaded, for messages and for its extension.
    std::string text;
};

/// A clicked position at which an actor should be placed on the ground.
struct GroundWish {
    std::string of;
    std::string from;            ///< See ActorEdits::Copy.
    std::array<double, 2> at{};  ///< x and y in relidar's world frame.
};

struct SaveWish {
    std::string name;  ///< Name of a folder: letters, digits, -, _ and . only.
    ActorEdits edits;
};

using Request = std::variant<ScanWish, SensorFile, SaveWish, GroundWish>;

/// Parses a request.
/// @throws UsageError that names a value that is missing, has another type or is out of
/// bounds
Request parse_request(const std::string& text);

}  // namespace relidar::view
