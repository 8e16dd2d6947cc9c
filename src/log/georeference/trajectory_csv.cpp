// SPDX-License-Identifier: Apache-2.0
// Writes trajectories as CSV files. read_trajectory() in src/run/edit/actor_path.cpp
// reads these files.
#include <relidar/base/files.hpp>
#include <relidar/log/trajectory_csv.hpp>

#include <cmath>

#include <fmt/format.h>

#include <relidar/log/log.hpp>

namespace relidar {

void write_trajectory(const std::filesystem::path& path, const PoseTrack& track,
                      const std::optional<GeoConverter>& earth) {
    std::string text = fmt::format("time_s,{},yaw_deg,pitch_deg,roll_deg\n",
                                   earth ? "latitude_deg,longitude_deg,height_m" : "x,y,z");
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        glm::dvec3 p = track.pose[i].translation;
        glm::dquat rotation = track.pose[i].rotation;
        if (earth) {
            const GeodeticPosition place = earth->to_geodetic(p);
            p = {place.latitude_deg, place.longitude_deg, place.height_m};
            rotation = glm::conjugate(earth->dataset_from_enu(place)) * rotation;
        }
        // yaw, pitch and roll of the rotation R = Rz(yaw) Ry(pitch) Rx(roll)
        const glm::dmat3 r = glm::mat3_cast(rotation);  // r[column][row]
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
