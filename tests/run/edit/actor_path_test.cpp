// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/edit.hpp>

#include <cmath>

#include <fmt/format.h>

#include <relidar/log/trajectory_csv.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

class TrajectoryFile : public TemporaryFolder {
protected:
    PoseTrack read(const std::string& text) {
        put(folder / "t.csv", text);
        return read_trajectory(folder / "t.csv");
    }
    std::string error(const std::string& text) {
        return get_data_error_message([&] { read(text); });
    }
};

TEST_F(TrajectoryFile, IsReadWithAndWithoutHeader) {
    for (const char* header : {"", "time_s,x,y,z,yaw_deg\r\n", " time_s, x, y, z, yaw_deg\n",
                               "\xEF\xBB\xBFtime_s,x,y,z,yaw_deg\r\n"}) {
        const PoseTrack track = read(std::string(header) + "0, 1, 2, 3, 0\n0.5,4,5,6,90\n\n");
        ASSERT_EQ(track.pose.size(), 2u);
        EXPECT_EQ(track.time_s[1], 0.5);
        EXPECT_EQ(track.pose[1].translation, glm::dvec3(4, 5, 6));
        EXPECT_LT(glm::length(track.pose[1].rotation * glm::dvec3(1, 0, 0) - glm::dvec3(0, 1, 0)), 1e-12);
    }
}

TEST_F(TrajectoryFile, CanNamePlacesOnTheEarth) {
    put(folder / "earth.csv",
        "time_s,latitude_deg,longitude_deg,height_m,yaw_deg\n0,0,9,7,0\n1,0,9.0001,7,90\n");
    EXPECT_THROW(read_trajectory(folder / "earth.csv"), UsageError) << "the run has no georeference";
    if (!has_proj()) GTEST_SKIP() << "built without PROJ";
    // The x axis of the world points north, y west.
    const GeodeticPosition origin{0.0, 9.0, 0.0};
    const Georeference place{
        origin, {1.0, 2.0, 3.0}, local_tangent_crs(origin), make_rotation(kPi / 2, 0.0, 0.0)};
    const PoseTrack track = read_trajectory(folder / "earth.csv", place);
    EXPECT_LT(glm::distance(track.pose[0].translation, glm::dvec3(1.0, 2.0, 10.0)), 1e-6);
    const double east_m = (6378137.0 + 7.0) * std::sin(0.0001 * kPi / 180.0);
    EXPECT_LT(glm::distance(track.pose[1].translation, glm::dvec3(1.0, 2.0 - east_m, 10.0)), 1e-4);
    EXPECT_LT(glm::distance(track.pose[0].rotation * glm::dvec3(1, 0, 0), glm::dvec3(0, -1, 0)), 1e-6);
    EXPECT_LT(glm::distance(track.pose[1].rotation * glm::dvec3(1, 0, 0), glm::dvec3(1, 0, 0)), 1e-4);
    EXPECT_THAT(error("time_s,latitude_deg,longitude_deg,yaw_deg\n0,0,9,0\n"),
                test::Names("line 1 ... height_m"));
    EXPECT_THAT(error("time_s,latitude_deg,longitude_deg,height_m,x,yaw_deg\n0,0,9,0,0,0\n"),
                test::Names("line 1 ... x"));
}

TEST_F(TrajectoryFile, OfAnActorCanBeOnTheGround) {
    const std::string text = "0,1,2,ground,0\n1,3,4, ground ,90\n";
    EXPECT_THAT(error(text), test::Names("t.csv ... `ground`")) << "a sensor does not stand on the ground";
    const PoseTrack track = read_actor_path(folder / "t.csv");
    ASSERT_EQ(track.pose.size(), 2u);
    EXPECT_TRUE(std::isnan(track.pose[0].translation.z) && std::isnan(track.pose[1].translation.z));
    EXPECT_EQ(glm::dvec2(track.pose[1].translation), glm::dvec2(3, 4));
    EXPECT_THAT(error("0,1,2,ground,0\n1,3,4,5,90\n"), test::Names("line 2 ... z"));
    EXPECT_THAT(error("0,1,2,5,0\n1,3,4,ground,90\n"), test::Names("line 2 ... z"));
    EXPECT_THAT(error("0,1,2,5,0\n1,ground,4,5,90\n"), test::Names("line 2 ... x"));
}

TEST_F(TrajectoryFile, ColumnsAreReadByNameOrPitchAndRollComeAfterYaw) {
    const double degree = kPi / 180.0;
    const std::string same[] = {
        "0,4,5,6,90\n1,4,5,6,90,30,20\n",
        "time_s,x,y,z,roll_deg,pitch_deg,yaw_deg\n0,4,5,6,20,30,90\n1,4,5,6,20,30,90\n",
        "yaw_deg,z,y,x,time_s,pitch_deg,roll_deg\n90,6,5,4,0,30,20\n90,6,5,4,1,30,20\n",
        fmt::format("time_s,x,y,z,yaw_rad,pitch_rad,roll_deg\n0,4,5,6,{0},{1},20\n1,4,5,6,{0},{1},20\n",
                    90 * degree, 30 * degree)};
    // R = Rz(90) Ry(30) Rx(20), computed by hand: a positive pitch lowers the nose, a
    // positive roll raises the left side.
    const glm::dvec3 forward(0.0, std::cos(30 * degree), -std::sin(30 * degree));
    for (const std::string& text : same) {
        const Pose pose = read(text).pose[1];
        EXPECT_EQ(pose.translation, glm::dvec3(4, 5, 6)) << text;
        EXPECT_LT(glm::length(pose.rotation * glm::dvec3(1, 0, 0) - forward), 1e-12) << text;
        EXPECT_NEAR((pose.rotation * glm::dvec3(0, 1, 0)).z, std::cos(30 * degree) * std::sin(20 * degree),
                    1e-12)
            << text;
    }
    EXPECT_THAT(error("time_s,x,y,z,yaw\n"), test::Names("line 1 ... 'yaw' ... 'yaw_deg'"));
    EXPECT_THAT(error("time_s,x,y,z,yaw\n"), test::Names("known: time_s, x, y, z, yaw_deg"));
    EXPECT_THAT(error("time_s,x,y,z,pitch_deg\n"), test::Names("'yaw_deg' ... 'yaw_rad' ... missing"));
    EXPECT_THAT(error("time_s,x,z,yaw_deg\n"), test::Names("column 'y' ... missing"));
    EXPECT_THAT(error("time_s,x,y,z,yaw_deg,yaw_rad\n"), test::Names("'yaw_deg' ... 'yaw_rad'"));
    EXPECT_THAT(error("time_s,x,y,z,yaw_deg\n0,1,2,3\n"), test::Names("line 2 ... 4 ... 5"));
}

TEST_F(TrajectoryFile, IsReadBackAsItWasWritten) {
    PoseTrack track;
    // seconds since 1970, coordinates of a large world
    for (int i = 0; i < 50; ++i)
        track.append(
            1317042272.25 + 0.1 * i,
            {glm::normalize(glm::dquat(std::cos(i), std::sin(2.0 * i), std::cos(3.0 * i), std::sin(i))),
             {455000.123 + i, 5428000.5 - i, 113.0}});
    write_trajectory(folder / "t.csv", track);
    const PoseTrack again = read_trajectory(folder / "t.csv");
    ASSERT_EQ(again.time_s, track.time_s);
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        EXPECT_EQ(again.pose[i].translation, track.pose[i].translation);
        EXPECT_NEAR(std::abs(glm::dot(again.pose[i].rotation, track.pose[i].rotation)), 1.0, 1e-12) << i;
    }
}

TEST_F(TrajectoryFile, ComplaintsNameLineAndColumn) {
    EXPECT_THAT(error("0,1,2,3,0\n1,nan,2,3,0\n"), test::Names("t.csv: line 2: x ... \"nan\" ... finite"));
    EXPECT_THAT(error("0,1,2,3,0\n1,1,2,3,\n"), test::Names("line 2: yaw_deg ... \"\""));
    EXPECT_THAT(error("0,1,2,3,0\n0,1,2,3,0\n"), test::Names("line 2 ... time_s ... 0 ... 0"));
    EXPECT_THAT(error("2,1,2,3,0\n1,1,2,3,0\n"), test::Names("increasing"));
    EXPECT_THAT(error("0,1,2,3\n"), test::Names("line 1 ... 4 columns"));
    EXPECT_THAT(error("0,1,2,3,4,5,6,7\n"), test::Names("8 columns"));
    EXPECT_THAT(error("time_s,x,y,z,yaw_deg\n0,1,2,3,0\n"), test::Names("1 poses"));
    EXPECT_THAT(error("time_s,x,y,z,yaw_deg,pitch_deg,roll_deg\n0,1,2,3,0,4,5\n1,1,2,3,0\n"),
                test::Names("line 3 ... 5 ... 7"));
    EXPECT_THAT(error("0,1,2,3,0,4,5\n1,1,2,3,0,4\n"), test::Names("line 2 ... 6 ... 7"));
    EXPECT_THAT(error(""), test::Names("0 poses"));
    EXPECT_THAT(get_data_error_message([&] { read_trajectory(folder / "none.csv"); }),
                test::Names("none.csv"));
}

}  // namespace
}  // namespace relidar
