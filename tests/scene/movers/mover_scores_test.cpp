// SPDX-License-Identifier: Apache-2.0
// Measures precision and recall of discovered moving objects. The synthetic streets
// contain cars, parked cars (some behind a fence), people and a cyclist. Their labels are
// removed from the log.
#include <cstdio>
#include <fstream>

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>
#include <relidar/scene/scene.hpp>

#include "base/random.hpp"

namespace relidar {
namespace {

// An object should be discovered if at least kMinVisibleFrames have kMinVisibleReturns.
constexpr std::size_t kMinVisibleReturns = 12, kMinVisibleFrames = 10;
constexpr double kFarthest_m = 40.0;  // discover_tracks() ignores objects farther away
// The centre of a discovered box must lie in the true box, enlarged by kInside_m. It may
// exceed the size of the true box by kLarger_m.
constexpr double kInside_m = 0.3, kLarger_m = 0.8;
constexpr double kDriftStep_m = 0.03, kDriftMargin_m = 1.0;  // drift of inaccurate poses

/// Returns the number of training frames in which each thing has enough returns.
std::vector<std::size_t> list_frames_that_see(const Log& log, const std::vector<int>& train,
                                              const std::vector<BoxTrack>& things) {
    std::vector<std::size_t> n_frames(things.size(), 0);
    for (const int position : train) {
        const Frame& frame = log.frames[std::size_t(position)];
        std::vector<std::size_t> n_returns(things.size(), 0);
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
            if (!(frame.scan.range_m[ray] > 0.0f && frame.scan.range_m[ray] < kFarthest_m)) continue;
            const WorldReturn w = locate_return(log, frame, ray);
            for (std::size_t i = 0; i < things.size(); ++i)
                n_returns[i] += things[i].contains_point(w.point_m, w.time_s, 0.0);
        }
        for (std::size_t i = 0; i < things.size(); ++i) n_frames[i] += n_returns[i] >= kMinVisibleReturns;
    }
    return n_frames;
}

/// Returns true if the centre of a discovered track is inside the true box most of the
/// time.
bool is_of(const BoxTrack& track, const BoxTrack& truth) {
    std::size_t inside = 0;
    for (std::size_t i = 0; i < track.world_from_box.time_s.size(); ++i) {
        const double t_s = track.world_from_box.time_s[i];
        inside += truth.is_observed(t_s) &&
                  truth.contains_point(track.world_from_box.pose[i].translation, t_s, kInside_m);
    }
    return 10 * inside >= 8 * track.world_from_box.time_s.size() &&
           track.size_m.x < truth.size_m.x + kLarger_m && track.size_m.y < truth.size_m.y + kLarger_m;
}

/// Returns the largest deviation of an object from its mean position in its discovered
/// box.
double measure_stray_m(const BoxTrack& track, const BoxTrack& thing) {
    std::vector<glm::dvec3> relative_m;
    for (std::size_t i = 0; i < track.world_from_box.time_s.size(); ++i)
        if (const double t_s = track.world_from_box.time_s[i]; thing.is_observed(t_s))
            relative_m.push_back(inverse(track.world_from_box.pose[i]) *
                                 thing.world_from_box.pose_at(t_s).translation);
    glm::dvec3 mean(0.0);
    for (const glm::dvec3& p : relative_m) mean += p / double(relative_m.size());
    double farthest = 0.0;
    for (const glm::dvec3& p : relative_m) farthest = std::max(farthest, glm::distance(p, mean));
    return farthest;
}

/// Appends the differences between the turns of an object and of its discovered box, in
/// degrees per tenth of a second.
void add_wobble(const BoxTrack& found, const BoxTrack& thing, std::vector<double>& wobble_deg) {
    const PoseTrack& track = found.world_from_box;
    const auto turned = [&](std::size_t index) {
        const glm::dvec3 ahead = inverse(thing.world_from_box.pose_at(track.time_s[index])).rotation *
                                 track.pose[index].rotation * glm::dvec3(1, 0, 0);
        return std::atan2(ahead.y, ahead.x);
    };
    for (std::size_t i = 1; i < track.pose.size(); ++i)
        wobble_deg.push_back(std::abs(std::remainder(turned(i) - turned(i - 1), 2.0 * kPi)) * 180.0 / kPi *
                             0.1 / (track.time_s[i] - track.time_s[i - 1]));
}

double compute_quantile(std::vector<double> values, double share) {
    std::sort(values.begin(), values.end());
    return values.at(std::size_t(share * double(values.size())));
}

struct Score {
    std::size_t discovered = 0, right = 0, present = 0, recalled = 0;
    std::vector<double> strayed_m, wobble_deg;  // errors of the correct detections
    double precision() const { return double(right) / double(std::max<std::size_t>(discovered, 1)); }
    double recall() const { return double(recalled) / double(std::max<std::size_t>(present, 1)); }
    void expect_good() const {
        std::printf("movers: %zu of %zu discovered are right, %zu of %zu visible ones are discovered\n",
                    right, discovered, recalled, present);
        EXPECT_GE(precision(), 0.95);
        EXPECT_GE(recall(), 0.95);
    }
};

/// A second detection of the same object counts as wrong.
void add_street(const StreetOptions& options, Score& score) {
    Log log = make_street_log(options);
    const std::vector<BoxTrack> truth = std::exchange(log.boxes, {});
    const std::vector<int> train = split_frames(log, 10).train;
    const std::vector<BoxTrack> tracks = discover_tracks(log, train);
    std::vector<char> is_matched(tracks.size(), 0);
    const std::vector<std::size_t> n_visible = list_frames_that_see(log, train, truth);
    score.discovered += tracks.size();
    for (std::size_t k = 0; k < truth.size(); ++k) {
        const BoxTrack& thing = truth[k];
        std::vector<double> covered;
        for (std::size_t i = 0; i < tracks.size(); ++i) {
            if (is_matched[i] || !is_of(tracks[i], thing)) continue;
            const std::vector<double>& times = tracks[i].world_from_box.time_s;
            if (2 * std::count_if(covered.begin(), covered.end(),
                                  [&](double t_s) { return t_s >= times.front() && t_s <= times.back(); }) >
                std::ptrdiff_t(times.size()))
                continue;
            is_matched[i] = 1;
            score.strayed_m.push_back(measure_stray_m(tracks[i], thing));
            add_wobble(tracks[i], thing, score.wobble_deg);
            ++score.right;
            covered.insert(covered.end(), times.begin(), times.end());
        }
        if (n_visible[k] < kMinVisibleFrames) continue;
        ++score.present;
        score.recalled += 2 * covered.size() >= n_visible[k];
    }
}

TEST(MoverScores, PrecisionAndRecallOnStreetsWithPeopleAndParkedCars) {
    Score score;
    StreetOptions street{.n_frames = 40, .rows = 64, .columns = 768, .range_noise_m = 0.02, .people = true};
    for (street.seed = 1; street.seed <= 4; ++street.seed) {
        street.speed_mps = street.seed % 2 ? 8.0 : 3.0;
        add_street(street, score);
    }
    score.expect_good();
    ASSERT_FALSE(score.strayed_m.empty());
    EXPECT_LT(compute_quantile(score.strayed_m, 0.8), 0.3) << "at the ends of the log, too";
    EXPECT_LT(compute_quantile(score.wobble_deg, 0.9), 0.3);
}

/// In a short log whose poses drift by 3 cm per frame, parked cars are observed from
/// changing sides at changing positions. No parked car may be discovered as moving.
TEST(MoverScores, NoParkedCarMovesWhereSidesAndPosesChange) {
    StreetOptions street{.n_frames = 27, .rows = 48, .columns = 768, .range_noise_m = 0.02};
    street.moving_cars = false;
    street.people = true;
    for (std::uint64_t seed = 1; seed <= 2; ++seed) {
        street.seed = seed;
        street.speed_mps = seed % 2 ? 3.0 : 8.0;
        Log log = make_street_log(street);
        const std::vector<BoxTrack> truth = std::exchange(log.boxes, {});
        Random random(seed);
        glm::dvec3 off_m(0.0);
        for (Pose& pose : log.world_from_vehicle.pose) {
            off_m += kDriftStep_m *
                     glm::dvec3(random.sample_normal(), random.sample_normal(), 0.3 * random.sample_normal());
            pose.translation += off_m;
        }
        for (const BoxTrack& mover : discover_tracks(log, split_frames(log, 10).train)) {
            const PoseTrack& track = mover.world_from_box;
            const bool is_one = std::ranges::any_of(truth, [&](const BoxTrack& thing) {
                std::size_t inside = 0;
                for (std::size_t i = 0; i < track.pose.size(); ++i)
                    inside +=
                        thing.contains_point(track.pose[i].translation, track.time_s[i], kDriftMargin_m);
                return 2 * inside > track.pose.size();
            });
            EXPECT_TRUE(is_one) << "street " << seed << ": " << mover.id << " in " << track.pose.size()
                                << " frames";
        }
    }
}

/// The lower beams of this LiDAR are up to 9 degrees apart. The upper of two such beams
/// seems to pass through the ground between them, which must not be discovered as moving.
TEST(MoverScores, UnevenBeams) {
    const std::filesystem::path rig = std::filesystem::path(testing::TempDir()) / "relidar_mover_scores.json";
    std::ofstream(rig) << R"({"sensors": [{"name": "top", "sensor": "vlp-32c"}]})";
    Score score;
    StreetOptions street{.n_frames = 30, .range_noise_m = 0.02, .rig = rig.string(), .people = true};
    for (street.seed = 1; street.seed <= 2; ++street.seed) {
        street.speed_mps = street.seed % 2 ? 8.0 : 3.0;
        add_street(street, score);
    }
    score.expect_good();
}

}  // namespace
}  // namespace relidar
