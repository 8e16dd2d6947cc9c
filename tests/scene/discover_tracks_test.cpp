// SPDX-License-Identifier: Apache-2.0
// Tracks of what moves without a label, against a synthetic street whose cars are known but not told.
#include <algorithm>

#include <gtest/gtest.h>

#include <relidar/dataset.hpp>
#include <relidar/reader.hpp>
#include <relidar/scene.hpp>

namespace relidar {
namespace {

struct Street {
    Sequence log;                   ///< without its boxes
    std::vector<BoxTrack> truth;    ///< those that move
    Split split;
};

Street street_without_labels() {
    Street street;
    street.log = make_synthetic_street({.n_frames = 24, .rows = 32, .columns = 512, .range_noise_m = 0.01});
    for (const BoxTrack& box : street.log.boxes)
        if (box.mean_step_m() > 0.05) street.truth.push_back(box);
    street.log.boxes.clear();
    street.split = split_frames(street.log, 10);
    return street;
}

/// The discovered track that is inside a box half-way through what both saw.
const BoxTrack* found_in(const std::vector<BoxTrack>& found, const BoxTrack& truth) {
    for (const BoxTrack& track : found) {
        const double from = std::max(track.world_from_box.time_s.front(), truth.world_from_box.time_s.front());
        const double to = std::min(track.world_from_box.time_s.back(), truth.world_from_box.time_s.back());
        if (from < to && truth.holds(track.world_from_box.at(0.5 * (from + to)).translation, 0.5 * (from + to), 0.3)) return &track;
    }
    return nullptr;
}

TEST(DiscoverTracks, FindsEveryCarAndNothingElse) {
    const Street street = street_without_labels();
    ASSERT_GE(street.truth.size(), 2u);
    const std::vector<BoxTrack> found = discover_tracks(street.log, street.split.train, {});
    EXPECT_EQ(found.size(), street.truth.size());
    for (const BoxTrack& truth : street.truth) {
        const BoxTrack* track = found_in(found, truth);
        ASSERT_NE(track, nullptr) << "box " << truth.id;
        EXPECT_EQ(track->category, kDiscoveredCategory);
        EXPECT_GE(track->world_from_box.time_s.size(), 6u);
        // A rigid body: the true box stands still in the frame of the discovered one.
        std::vector<glm::dvec3> place;
        for (std::size_t i = 0; i < track->world_from_box.time_s.size(); ++i) {
            const double t_s = track->world_from_box.time_s[i];
            if (truth.present(t_s)) place.push_back(inverse(track->world_from_box.pose[i]) * truth.world_from_box.at(t_s).translation);
        }
        ASSERT_GE(place.size(), 6u);
        glm::dvec3 mean(0.0);
        for (const glm::dvec3& p : place) mean += p / double(place.size());
        std::vector<double> off;
        for (const glm::dvec3& p : place) off.push_back(glm::distance(p, mean));
        std::sort(off.begin(), off.end());
        EXPECT_LT(off[off.size() / 2], 0.15) << "box " << truth.id;
        EXPECT_LT(off.back(), 0.4) << "box " << truth.id << ": at the ends of the log few frames tell what moved";
        EXPECT_LT(track->size_m.x, truth.size_m.x + 0.8);
        EXPECT_LT(track->size_m.y, truth.size_m.y + 0.8);
    }
}

/// Beside a LiDAR that sees little, and beside one that sees the same.
TEST(DiscoverTracks, FindsWhatAnyLidarOfARigSees) {
    for (const bool first_sees_all : {false, true}) {
        Street street = street_without_labels();
        std::vector<Frame> frames;
        for (const Frame& frame : street.log.frames)
            for (const int lidar : {0, 1}) {
                frames.push_back(frame);
                frames.back().lidar = lidar;
                if (lidar == 1 || first_sees_all) continue;
                for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
                    if (frame.scan.rays.direction[i].x < 0.98f) frames.back().scan.range_m[i] = frames.back().scan.intensity[i] = 0.0f;
            }
        street.log.lidars.push_back(street.log.lidars[0]);
        street.log.lidars[0].name = "first", street.log.lidars[1].name = "second";
        street.log.frames = std::move(frames);
        check_sequence(street.log);
        const std::vector<BoxTrack> found = discover_tracks(street.log, split_frames(street.log, 10).train, {});
        EXPECT_EQ(found.size(), street.truth.size()) << first_sees_all;
        for (const BoxTrack& truth : street.truth) EXPECT_NE(found_in(found, truth), nullptr) << "box " << truth.id;
    }
}

TEST(DiscoverTracks, LeavesLabelledAndRestingThingsAlone) {
    Street street = street_without_labels();
    street.log.boxes = street.truth;
    EXPECT_TRUE(discover_tracks(street.log, street.split.train, {}).empty());
}

/// Labels of a drive end where the camera's view does: what stood then stands before and after.
TEST(DiscoverTracks, NothingMovesThatAStillLabelCovers) {
    Street street = street_without_labels();
    BoxTrack still{.id = "still", .category = "Van", .size_m = glm::dvec3(300.0, 300.0, 30.0), .world_from_box = {}};
    for (const int frame : {10, 11}) {
        still.world_from_box.time_s.push_back(street.log.frames[std::size_t(frame)].time_s);
        still.world_from_box.pose.push_back({});
    }
    street.log.boxes = {still};
    EXPECT_TRUE(discover_tracks(street.log, street.split.train, {}).empty());
}

/// A roof rack: returns that every scan has at the same place of its own.
TEST(DiscoverTracks, LeavesItsOwnVehicleAlone) {
    Street street = street_without_labels();
    for (Frame& frame : street.log.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            const glm::vec3& d = frame.scan.rays.direction[i];
            if (d.x < -0.6f && d.y > 0.2f && d.y < 0.5f && d.z > -0.35f && d.z < -0.15f) frame.scan.range_m[i] = 1.3f;
        }
    EXPECT_EQ(discover_tracks(street.log, street.split.train, {}).size(), street.truth.size());
}

TEST(DiscoverTracks, LooksAtTrainingFramesOnly) {
    Street street = street_without_labels();
    const std::vector<BoxTrack> before = discover_tracks(street.log, street.split.train, {});
    for (float& range : street.log.frames[10].scan.range_m) range = 5.0f;
    const std::vector<BoxTrack> after = discover_tracks(street.log, street.split.train, {});
    ASSERT_EQ(before.size(), after.size());
    for (std::size_t i = 0; i < before.size(); ++i) {
        ASSERT_EQ(before[i].world_from_box.time_s, after[i].world_from_box.time_s);
        EXPECT_EQ(std::count(before[i].world_from_box.time_s.begin(), before[i].world_from_box.time_s.end(), street.log.frames[10].time_s),
                  0);
        for (std::size_t k = 0; k < before[i].world_from_box.pose.size(); ++k)
            EXPECT_EQ(before[i].world_from_box.pose[k].translation, after[i].world_from_box.pose[k].translation);
    }
}

TEST(DiscoverTracks, BecomeActors) {
    Street street = street_without_labels();
    InitialiseOptions options;
    options.discover_actors = true;
    options.actor_min_points = 20;
    for (const BoxTrack& box : discover_tracks(street.log, street.split.train, options)) street.log.boxes.push_back(box);
    EXPECT_EQ(initialise_scene(street.log, street.split.train, options).models.size(), 1 + street.truth.size());
    options.discover_actors = false;
    options.actor_classes = "Car";
    EXPECT_EQ(initialise_scene(street.log, street.split.train, options).models.size(), 1u) << "no class is wanted: masked instead";
}

}  // namespace
}  // namespace relidar
