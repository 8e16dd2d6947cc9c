// SPDX-License-Identifier: Apache-2.0
// Adds returns of a carrier to logs whose scenery is known, and searches them again.
#include <relidar/log/own_body.hpp>

#include <cmath>
#include <cstdio>
#include <functional>
#include <numeric>

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>

namespace relidar {
namespace {

constexpr double kOneDegree = 3.14159265358979323846 / 180.0;

std::vector<int> all_frames(const Log& log) {
    std::vector<int> frames(log.frames.size());
    std::iota(frames.begin(), frames.end(), 0);
    return frames;
}

/// A person behind the sensor: 60 degrees wide, up to 17 degrees of elevation.
bool is_on_person(const glm::vec3& direction) {
    return std::abs(std::atan2(direction.y, direction.x)) > 150.0 * kOneDegree && direction.z < 0.3f;
}

/// Replaces the ranges of all scans. The function returns 0 for a ray without a return.
void set_ranges(Log& log, const std::function<float(const glm::vec3& direction, float range_m)>& range_of) {
    for (Frame& frame : log.frames)
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
            frame.scan.range_m[ray] = range_of(frame.scan.rays.direction[ray], frame.scan.range_m[ray]);
            frame.scan.intensity[ray] = frame.scan.range_m[ray] > 0.0f ? 0.5f : 0.0f;
        }
}

Log street_with_person() {
    Log log = make_street_log({.n_frames = 12, .rows = 16, .columns = 512});
    int n = 0;
    set_ranges(log, [&](const glm::vec3& direction, float range_m) {
        return is_on_person(direction) ? 0.4f + 0.01f * float(++n % 5 - 2) : range_m;
    });
    return log;
}

/// A log of a sensor that moves straight along x, among surfaces that extend along x.
Log straight_log(double step_m, const std::function<float(const glm::vec3& direction)>& range_of) {
    static const Log street = make_street_log({.n_frames = 15, .rows = 32, .columns = 360});
    Log log = street;
    for (std::size_t k = 0; k < log.world_from_vehicle.pose.size(); ++k)
        log.world_from_vehicle.pose[k] = {.translation = {step_m * double(k), 0.0, 0.0}};
    set_ranges(log, [&](const glm::vec3& direction, float) { return range_of(direction); });
    return log;
}

/// Range of ground below and walls on both sides; 0 without a wall in this direction.
float tunnel_range_m(const glm::vec3& direction, float height_m, float wall_m) {
    const float range_m = std::min(direction.z < 0.0f ? height_m / -direction.z : 1e9f,
                                   wall_m / std::max(std::abs(direction.y), 1e-9f));
    return range_m < 80.0f ? range_m : 0.0f;
}

TEST(OwnBody, IsFoundWhereItIs) {
    Log log = street_with_person();
    const OwnBody body = find_own_body(log, 0, all_frames(log));
    std::size_t n_on_person = 0, n_returns = 0;
    for (const Frame& frame : log.frames)
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
            const glm::vec3& direction = frame.scan.rays.direction[ray];
            const float range_m = frame.scan.range_m[ray];
            n_returns += range_m > 0.0f;
            n_on_person += is_on_person(direction);
            // A dropped ray next to the person may have hit the person.
            if (range_m > 0.0f) {
                ASSERT_EQ(body.table.hides(direction, range_m), is_on_person(direction));
            }
            if (is_on_person(direction)) {
                const std::size_t cell = BodyTable::cell_of(direction);
                EXPECT_NEAR(body.table.range_m[cell], 0.4f, 0.021f);
                EXPECT_EQ(body.table.intensity[cell], 0.5f);
                EXPECT_TRUE(body.table.hides(direction, 0.0f));
            }
        }
    EXPECT_NEAR(body.share, double(n_on_person) / double(n_returns), 1e-9);
    int first = 0, last = 0;
    const std::string text = body.describe();
    const std::size_t at = text.find("azimuth");
    ASSERT_NE(at, std::string::npos) << text;
    ASSERT_EQ(std::sscanf(text.c_str() + at, "azimuth %d to %d degrees, 0.4 m;", &first, &last), 2) << text;
    EXPECT_NEAR(first, 150, 1);
    EXPECT_NEAR(last, 210, 1);
}

TEST(OwnBody, ItsReturnsAreRemovedFromTheGivenFrames) {
    Log log = street_with_person();
    const Log before = log;
    log.lidars[0].own_body = find_own_body(log, 0, all_frames(log)).table;
    hide_own_body(log, {0, 2});
    for (const std::size_t f : {0, 1, 2})
        for (std::size_t ray = 0; ray < log.frames[f].scan.range_m.size(); ++ray) {
            const bool is_removed = f != 1 && is_on_person(log.frames[f].scan.rays.direction[ray]);
            ASSERT_EQ(log.frames[f].scan.range_m[ray],
                      is_removed ? 0.0f : before.frames[f].scan.range_m[ray]);
        }
}

TEST(OwnBody, SceneryWithConstantRangesIsNotTheBody) {
    const auto expect_none = [](const Log& log, const char* what) {
        const OwnBody body = find_own_body(log, 0, all_frames(log));
        EXPECT_TRUE(body.table.empty()) << what << ": " << body.share;
    };
    expect_none(make_street_log({.n_frames = 20, .rows = 32, .columns = 360, .people = true}), "street");
    for (const double step_m : {0.25, 0.8, 2.5}) {
        expect_none(straight_log(step_m, [](const glm::vec3& d) { return tunnel_range_m(d, 1.2f, 1e9f); }),
                    "flat ground");
        expect_none(straight_log(step_m, [](const glm::vec3& d) { return tunnel_range_m(d, 0.5f, 1.5f); }),
                    "tunnel");
        const auto rail = [](const glm::vec3& d) {
            const float side_m = 2.0f / std::max(d.y, 1e-9f), height_m = side_m * d.z;
            const bool is_rail = side_m < 80.0f && height_m > -0.6f && height_m < -0.3f;
            return is_rail ? side_m : tunnel_range_m(d, 1.2f, 12.0f);
        };
        expect_none(straight_log(step_m, rail), "guard rail");
        const auto car_ahead = [](const glm::vec3& d) {
            return d.x > 0.95f && std::abs(d.z) < 0.1f ? 6.0f / d.x : tunnel_range_m(d, 1.5f, 12.0f);
        };
        expect_none(straight_log(step_m, car_ahead), "a car that drives ahead at equal speed");
    }
}

TEST(OwnBody, NeedsASensorThatMoves) {
    const auto with_person = [](const glm::vec3& d) {
        return is_on_person(d) ? 0.4f : tunnel_range_m(d, 1.2f, 4.0f);
    };
    EXPECT_FALSE(find_own_body(straight_log(0.3, with_person), 0, {0, 2, 4, 6, 8, 10, 12, 14}).table.empty());
    EXPECT_TRUE(find_own_body(straight_log(0.3, with_person), 0, {0, 4, 8, 12}).table.empty()) << "few scans";
    const Log standing = straight_log(0.001, with_person);
    EXPECT_TRUE(find_own_body(standing, 0, all_frames(standing)).table.empty());
}

TEST(OwnBody, DirectionsOfCellsAreInverse) {
    for (std::size_t cell = 0; cell < BodyTable::kCells; cell += 37)
        ASSERT_EQ(BodyTable::cell_of(BodyTable::direction_of(cell)), cell);
    EXPECT_FALSE(BodyTable{}.hides({1.0f, 0.0f, 0.0f}, 0.0f));
}

}  // namespace
}  // namespace relidar
