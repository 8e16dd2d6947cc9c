// SPDX-License-Identifier: Apache-2.0
// Writes trajectories as CSV files. read_trajectory() in src/run/edit/actor_path.cpp
// reads these files.
#include <relidar/base/files.hpp>
#include <relidar/log/trajectory_csv.hpp>

#include <cmath>

#include <fmt/format.h>

#include <relidar/log/sequence.hpp>

namespace relidar {

void write_trajectory(const std::filesystem::path& path, const PoseTrack& track) {
    std::string text = "time_s,x,y,z,yaw_deg,pitch_deg,roll_deg\n";
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        const glm::dvec3 p = track.pose[i].translation;
        // yaw, pitch and roll of the rotation R = Rz(yaw) Ry(pitch) Rx(roll)
        const glm::dmat3 r = glm::mat3_cast(track.pose[i].rotation);  // r[column][row]
        const glm::dvec3 angles_deg =
            180.0 / kPi *
            glm::dvec3(std::atan2(r[0][1], r[0][0]), std::atan2(-r[0][2], std::hypot(r[0][0], r[0][1])),
                       std::atan2(r[1][2], r[2][2]));
        text += fmt::format("{},{},{},{},{},{},{}\n", track.time_s[i], p.x, p.y, p.z, angles_deg.x,
                            angles_deg.y, angles_deg.z);
    }
    write_text_file(path, text);
}

}  // namespace relidar
