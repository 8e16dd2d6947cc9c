// SPDX-License-Identifier: Apache-2.0
// What the page asks for, as JSON texts on the WebSocket:
//   {"do": "scan", "id": 7, "time_s": 1.5, "place": [x, y, z, yaw_deg, pitch_deg, roll_deg], "sensor": "VLP-16", "lidar": 0,
//    "weather": "fog=50", "simulate": true, "real": false, "edits": EDITS}
//   {"do": "sensor", "file": "beams.csv", "text": "..."}         from then on a sensor named "file"
//   {"do": "ground", "of": TRACK, "from": RUN, "at": [x, y]}     where a copy stands on the ground there
//   {"do": "save", "name": "run2", "edits": EDITS}
// EDITS: {"copies": [{"of": TRACK, "from": RUN, "at": [x, y, z, yaw_deg, pitch_deg,
// roll_deg, speed_mps]}], "moves": {TRACK: [x, y, z, yaw_deg]}, "removed": [TRACK],
// "hidden": [TRACK]}; RUN is "" or one of the other runs of `hello`; places in relidar's
// world, moves in the actor's own frame. All of it comes from outside and is checked
// here.
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

/// Changes of the traffic. They take effect in this order: copies, moves, what is gone.
struct ActorEdits {
    struct Copy {
        std::string of;
        std::string from;  ///< name of the run that has it; empty: the one that is shown
        /// x, y, z in relidar's world, yaw_deg, pitch_deg, roll_deg, speed_mps straight
        /// ahead
        std::array<double, 7> at{};
        bool operator==(const Copy&) const = default;
    };
    std::vector<Copy> copies;
    /// forward, left, up, yaw_deg in the actor's own frame
    std::map<std::string, std::array<double, 4>> moves;
    std::set<std::string> removed;
    std::set<std::string> hidden;  ///< on the screen alone; saved all the same
    bool operator==(const ActorEdits&) const = default;
};

struct ScanWish {
    std::int64_t id = 0;  ///< comes back with the scan
    double time_s = 0.0;
    Pose sensor_offset;  ///< in the frame of the log's LiDAR
    std::string sensor = "native";
    int lidar = 0;
    Weather weather = {};
    bool simulate = true;
    bool real = false;  ///< the log's scan nearest in time, too
    ActorEdits edits;
};

struct SensorFile {
    std::string name;  ///< as it was called, for messages and for its ending
    std::string text;
};

/// A place on which somebody has clicked, for an actor to stand there.
struct GroundWish {
    std::string of;
    std::string from;            ///< as in ActorEdits::Copy
    std::array<double, 2> at{};  ///< x, y in relidar's world
};

struct SaveWish {
    std::string name;  ///< of a folder: letters, digits, -, _ and .
    ActorEdits edits;
};

using Request = std::variant<ScanWish, SensorFile, SaveWish, GroundWish>;

/// @throws UsageError naming what is missing, of another type or out of bounds
Request parse_request(const std::string& text);

}  // namespace relidar::view
