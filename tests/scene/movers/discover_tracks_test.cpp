// SPDX-License-Identifier: Apache-2.0
// Tests the discovery of moving objects without labels. The cars of a synthetic street
// are the ground truth. Their labels are removed from the log.

#include <gtest/gtest.h>
#include <algorithm>

#include <relidar/base/math.hpp>
#include <relidar/log/checks.hpp>
#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/scene/scene.hpp>

#include "base/random.hpp"
#include "scene/movers/mover_tracks.hpp"

namespace relidar {
namespace {

struct Street {
    Log log;                      ///< log without boxes
    std::vector<BoxTrack> truth;  ///< true boxes that move
    Split split;
    std::vector<BoxTrack> discover() const { return discover_tracks(log, split.train); }
};

Street make_street_without_labels() {
    Street street;
    street.log = make_street_log({.n_frames = 24, .rows = 32, .columns = 512, .range_noise_m = 0.01});
    for (const BoxTrack& box : street.log.boxes)
        if (box.is_moving()) street.truth.push_back(box);
    street.log.boxes.clear();
    street.split = split_frames(street.log, 10);
    return street;
}

/// Returns the track whose centre lies inside a true box in the middle of their time.
const BoxTrack* fingerprint_of(const std::vector<BoxTrack>& tracks, const BoxTrack& truth) {
    for (const BoxTrack& track : tracks) {
        const double from =
            std::max(track.world_from_box.time_s.front(), truth.world_from_box.time_s.front());
        const double to = std::min(track.world_from_box.time_s.back(), truth.world_from_box.time_s.back());
        if (from < to && truth.contains_point(track.world_from_box.pose_at(0.5 * (from + to)).translation,
                                              0.5 * (from + to), 0.3))
            return &track;
    }
    return nullptr;
}

/// Removes the labels of a box except in some frames. Returns the times of the others.
std::vector<double> cut_labels(BoxTrack& box, const std::vector<Frame>& frames, std::size_t first,
                               std::size_t end) {
    const BoxTrack original_box = box;
    std::vector<double> cut_s;
    box.world_from_box = {};
    for (std::size_t f = 0; f < frames.size(); ++f) {
        const double t_s = frames[f].time_s;
        if (f < first || f >= end) {
            cut_s.push_back(t_s);
            continue;
        }
        box.world_from_box.time_s.push_back(t_s);
        box.world_from_box.pose.push_back(original_box.world_from_box.pose_at(t_s));
    }
    return cut_s;
}

/// Labels from camera images start and end at the border of the image.
TEST(DiscoverTracks, ContinuesALabelledBoxBesideItsLabels) {
    for (const auto& [first, end] : {std::pair<std::size_t, std::size_t>{0, 10}, {14, 24}, {8, 16}}) {
        Street street = make_street_without_labels();
        street.log.boxes = street.truth;
        // uses the oncoming car, because only the rear of the leading car is visible
        const BoxTrack& truth = street.truth[1];
        const std::vector<double> cut_s = cut_labels(street.log.boxes[1], street.log.frames, first, end);
        const std::vector<BoxTrack> found = street.discover();
        ASSERT_EQ(found.size(), 1u) << "no second actor; labels " << first << " to " << end;
        const BoxTrack& box = found[0];
        EXPECT_EQ(box.id, truth.id);
        EXPECT_EQ(box.category, truth.category);
        EXPECT_EQ(box.size_m, truth.size_m);
        EXPECT_EQ(box.n_before > 0, first > 0);
        EXPECT_EQ(box.n_after > 0, end < 24);
        EXPECT_EQ(box.labelled_part().world_from_box.time_s, street.log.boxes[1].world_from_box.time_s);
        const std::ptrdiff_t n_visible_labels =
            std::ranges::count_if(cut_s, [&](double t_s) { return t_s >= 0.9 && t_s < 2.4; });
        EXPECT_GE(box.n_before + box.n_after, std::size_t(n_visible_labels) - 2)
            << "two frames are held out; before it is out of sight";
        EXPECT_TRUE(std::ranges::is_sorted(box.world_from_box.time_s));
        for (std::size_t k = 0; k < box.world_from_box.time_s.size(); ++k) {
            const Pose at = truth.world_from_box.pose_at(box.world_from_box.time_s[k]),
                       off = inverse(at) * box.world_from_box.pose[k];
            EXPECT_LT(glm::length(off.translation), 0.3) << box.world_from_box.time_s[k];
            EXPECT_LT(glm::angle(off.rotation), 4.0 * kPi / 180.0) << box.world_from_box.time_s[k];
        }
    }
}

/// An object that is hidden for 0.8 s must be discovered as a single track.
TEST(DiscoverTracks, JoinsPartsAroundAGap) {
    Street street = make_street_without_labels();
    const BoxTrack& truth = street.truth[0];
    for (std::size_t f = 8; f < 15; ++f) {
        Frame& frame = street.log.frames[f];
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
            if (frame.scan.range_m[ray] > 0.0f)
                if (const WorldReturn w = locate_return(street.log, frame, ray);
                    truth.contains_point(w.point_m, w.time_s, 0.1))
                    frame.scan.range_m[ray] = frame.scan.intensity[ray] = 0.0f;
    }
    const std::vector<BoxTrack> found = street.discover();
    EXPECT_EQ(found.size(), street.truth.size());
    const BoxTrack* track = fingerprint_of(found, truth);
    ASSERT_NE(track, nullptr);
    EXPECT_EQ(track->category, kDiscoveredCategory);
    EXPECT_LT(track->world_from_box.time_s.front(), street.log.frames[4].time_s);
    EXPECT_GT(track->world_from_box.time_s.back(), street.log.frames[18].time_s);
}

TEST(DiscoverTracks, GuessesTheLengthOfWhatShowsItsRearAlone) {
    const Street street = make_street_without_labels();
    const std::vector<BoxTrack> found = street.discover();
    const BoxTrack *ahead = fingerprint_of(found, street.truth[0]),
                   *oncoming = fingerprint_of(found, street.truth[1]);
    ASSERT_TRUE(ahead && oncoming);
    EXPECT_EQ(ahead->size_guess, "car");
    EXPECT_NEAR(ahead->size_m.x, street.truth[0].size_m.x, 0.5);
    EXPECT_TRUE(oncoming->size_guess.empty()) << "it has passed: its side was seen";
    for (std::size_t k = 0; k < ahead->world_from_box.time_s.size(); ++k) {
        const double t_s = ahead->world_from_box.time_s[k];
        EXPECT_LT(glm::distance(glm::dvec2(ahead->world_from_box.pose[k].translation),
                                glm::dvec2(street.truth[0].world_from_box.pose_at(t_s).translation)),
                  0.5)
            << "filled up ahead, " << t_s;
    }
}

/// The second LiDAR has all returns. The first LiDAR has few returns on the objects in
/// the first case, and all returns in the second case.
TEST(DiscoverTracks, FindsWhatAnyLidarOfARigSees) {
    for (const bool first_frame_is_complete : {false, true}) {
        Street street = make_street_without_labels();
        std::vector<Frame> frames;
        for (const Frame& frame : street.log.frames)
            for (const int lidar : {0, 1}) {
                frames.push_back(frame);
                frames.back().lidar = lidar;
                if (lidar == 1 || first_frame_is_complete) continue;
                for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
                    if (frame.scan.rays.direction[i].x < 0.98f)
                        frames.back().scan.range_m[i] = frames.back().scan.intensity[i] = 0.0f;
            }
        street.log.lidars.push_back(street.log.lidars[0]);
        street.log.lidars[0].name = "first";
        street.log.lidars[1].name = "second";
        street.log.frames = std::move(frames);
        check_log(street.log);
        const std::vector<BoxTrack> found = discover_tracks(street.log, split_frames(street.log, 10).train);
        EXPECT_EQ(found.size(), street.truth.size()) << first_frame_is_complete;
        for (const BoxTrack& truth : street.truth)
            EXPECT_NE(fingerprint_of(found, truth), nullptr) << "box " << truth.id;
    }
}

TEST(DiscoverTracks, LeavesLabelledAndRestingThingsAlone) {
    Street street = make_street_without_labels();
    street.log.boxes = street.truth;
    EXPECT_TRUE(street.discover().empty());
}

/// Objects that are static while they have labels must not be discovered as moving.
TEST(DiscoverTracks, NothingMovesThatAStillLabelCovers) {
    Street street = make_street_without_labels();
    BoxTrack still{
        .id = "still", .category = "Van", .size_m = glm::dvec3(300.0, 300.0, 30.0), .world_from_box = {}};
    for (const int frame : {10, 11}) {
        still.world_from_box.time_s.push_back(street.log.frames[std::size_t(frame)].time_s);
        still.world_from_box.pose.push_back({});
    }
    street.log.boxes = {still};
    EXPECT_TRUE(street.discover().empty());
}

/// A roof rack: returns at the same position relative to the sensor in every scan.
TEST(DiscoverTracks, LeavesItsOwnVehicleAlone) {
    Street street = make_street_without_labels();
    for (Frame& frame : street.log.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            const glm::vec3& d = frame.scan.rays.direction[i];
            if (d.x < -0.6f && d.y > 0.2f && d.y < 0.5f && d.z > -0.35f && d.z < -0.15f)
                frame.scan.range_m[i] = 1.3f;
        }
    EXPECT_EQ(street.discover().size(), street.truth.size());
}

TEST(DiscoverTracks, LooksAtTrainingFramesOnly) {
    Street street = make_street_without_labels();
    const std::vector<BoxTrack> before = street.discover();
    for (float& range : street.log.frames[10].scan.range_m) range = 5.0f;
    const std::vector<BoxTrack> after = street.discover();
    ASSERT_EQ(before.size(), after.size());
    for (std::size_t i = 0; i < before.size(); ++i) {
        ASSERT_EQ(before[i].world_from_box.time_s, after[i].world_from_box.time_s);
        EXPECT_EQ(std::ranges::count(before[i].world_from_box.time_s, street.log.frames[10].time_s), 0);
        for (std::size_t k = 0; k < before[i].world_from_box.pose.size(); ++k)
            EXPECT_EQ(before[i].world_from_box.pose[k].translation,
                      after[i].world_from_box.pose[k].translation);
    }
}

TEST(DiscoverTracks, BecomeActors) {
    Street street = make_street_without_labels();
    InitOptions options;
    options.unlabelled_movers = UnlabelledMoverPolicy::actors;
    options.actor_min_points = 20;
    street.log.boxes = street.discover();
    EXPECT_EQ(init_scene(street.log, street.split.train, options).models.size(), 1 + street.truth.size());
    options.unlabelled_movers = UnlabelledMoverPolicy::removed;
    options.actor_classes = "Car";
    EXPECT_EQ(init_scene(street.log, street.split.train, options).models.size(), 1u)
        << "no class is wanted: masked instead";
}

std::vector<double> make_tenths(int count) {
    std::vector<double> times;
    for (int k = 0; k < count; ++k) times.push_back(3.0 + 0.1 * k + (k > 20 ? 0.4 : 0.0));  // with a gap
    return times;
}

TEST(MoverPath, KeepsConstantAcceleration) {
    const std::vector<double> times = make_tenths(40);
    std::vector<glm::dvec3> positions_m;
    for (const double t : times) positions_m.push_back({20.0 - 3.0 * t + 0.8 * t * t, 5.0 * t, 0.1 * t});
    const std::vector<KinematicState> path = smooth_path(times, positions_m);
    for (std::size_t k = 0; k < times.size(); ++k) {
        EXPECT_LT(glm::distance(path[k].position_m, positions_m[k]), 0.01) << k;
        EXPECT_LT(glm::distance(path[k].velocity_mps, glm::dvec3(-3.0 + 1.6 * times[k], 5.0, 0.1)), 0.05);
        const double later = times[k] + 0.05;
        const glm::dvec3 truth(20.0 - 3.0 * later + 0.8 * later * later, 5.0 * later, 0.1 * later);
        EXPECT_LT(glm::distance(path[k].position_after(0.05), truth), 0.02);
    }
}

TEST(MoverPath, SpeedsNeedNoShortTimeSteps) {
    for (const double step_s : {0.1, 0.5, 2.0}) {
        BoxTrack box;
        for (int k = 0; k < 30; ++k) {
            box.world_from_box.time_s.push_back(step_s * k);
            box.world_from_box.pose.push_back({{}, {3.0 * step_s * k, 0.0, 0.0}});
        }
        const std::vector<double> speeds = speeds_mps(box);
        EXPECT_GE(speeds.size(), 25u) << step_s;
        for (const double speed : speeds) EXPECT_NEAR(speed, 3.0, 1e-9) << step_s;
    }
}

TEST(MoverPath, TakesNoiseOutAndLeavesOutliersAside) {
    const std::vector<double> times = make_tenths(60);
    std::vector<glm::dvec3> truth, positions_m;
    Random random(5);
    for (const double t : times) {
        // a curve of 8 m radius at 4 m/s
        truth.push_back({8.0 * std::sin(0.5 * t), 8.0 - 8.0 * std::cos(0.5 * t), 0.0});
        positions_m.push_back(truth.back() +
                              0.05 * glm::dvec3(random.sample_normal(), random.sample_normal(), 0.0));
    }
    positions_m[30] += glm::dvec3(2.0, -2.0, 0.0);
    const std::vector<KinematicState> path = smooth_path(times, positions_m);
    std::vector<glm::dvec3> smooth;
    double squares = 0.0;
    for (std::size_t k = 0; k < times.size(); ++k) {
        smooth.push_back(path[k].position_m);
        const double off = glm::distance(path[k].position_m, truth[k]);
        squares += off * off / double(times.size());
        EXPECT_LT(off, 0.15) << k;
    }
    EXPECT_LT(std::sqrt(squares), 0.05) << "of noise of 0.07 m";
    const std::vector<double> yaw = path_headings_rad(smooth);
    for (std::size_t k = 15; k + 15 < times.size(); ++k)
        EXPECT_LT(std::abs(std::remainder(yaw[k] - 0.5 * times[k], 2.0 * kPi)), 3.0 * kPi / 180.0) << k;
}

/// An object brakes, stops for three seconds with position noise of 3 cm, and drives on.
/// Its heading must stay constant during the stop.
TEST(MoverPath, StandsWithTheHeadingItCameWith) {
    std::vector<double> times;
    std::vector<glm::dvec3> positions_m, smooth;
    Random random(7);
    for (int k = 0; k < 100; ++k) {
        // at 2 m/s^2
        const double t = 0.1 * k, brakes = std::clamp(2.0 - (t - 1.0), 0.0, 2.0),
                     starts = std::max(t - 6.0, 0.0);
        times.push_back(t);
        positions_m.push_back(
            glm::dvec3(4.0 * std::min(t - 1.0, 0.0) - brakes * brakes + starts * starts, 0.0, 0.0) +
            0.03 * glm::dvec3(random.sample_normal(), random.sample_normal(), 0.0));
    }
    for (const KinematicState& state : smooth_path(times, positions_m)) smooth.push_back(state.position_m);
    const std::vector<double> yaw = path_headings_rad(smooth);
    for (std::size_t k = 0; k < yaw.size(); ++k) EXPECT_LT(std::abs(yaw[k]), 3.0 * kPi / 180.0) << k;
    for (std::size_t k = 31; k < 60; ++k)
        EXPECT_LT(std::abs(yaw[k] - yaw[k - 1]), 0.5 * kPi / 180.0) << "it stands, " << k;
}

}  // namespace

}  // namespace relidar
