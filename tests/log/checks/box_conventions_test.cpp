// SPDX-License-Identifier: Apache-2.0
#include "log/checks/box_conventions.hpp"

#include <gmock/gmock.h>

#include <relidar/read/dataset.hpp>

namespace relidar {
namespace {

using testing::HasSubstr;

std::string describe_fault_after(const std::function<void(BoxTrack&, Pose&)>& change) {
    static const Log street = make_street_log({.n_frames = 8, .rows = 32, .columns = 720});
    Log log = street;
    for (BoxTrack& box : log.boxes)
        for (Pose& pose : box.world_from_box.pose) change(box, pose);
    return checks::describe_fault(log);
}

void swap_length_and_width(BoxTrack& box, Pose& pose) {
    if (&pose == &box.world_from_box.pose.front()) std::swap(box.size_m.x, box.size_m.y);
}

TEST(BoxConventions, RightBoxesHaveNoFault) {
    EXPECT_EQ(describe_fault_after([](BoxTrack&, Pose&) {}), "");
}

TEST(BoxConventions, BottomCentresAreRecognised) {
    EXPECT_THAT(describe_fault_after([](BoxTrack& box, Pose& pose) {
                    pose.translation -= pose.rotation * glm::dvec3(0, 0, 0.5 * box.size_m.z);
                }),
                HasSubstr("bottom"));
}

TEST(BoxConventions, SwappedSidesAndTurnedBoxesAreRecognised) {
    EXPECT_THAT(describe_fault_after(swap_length_and_width), HasSubstr("length and width"));
    const glm::dquat quarter_turn = make_rotation(kPi / 2, 0, 0);
    EXPECT_THAT(
        describe_fault_after([&](BoxTrack&, Pose& pose) { pose.rotation = pose.rotation * quarter_turn; }),
        HasSubstr("90 degrees"));
    // The length is the y axis of these boxes, which are at the right places.
    EXPECT_EQ(describe_fault_after([&](BoxTrack& box, Pose& pose) {
                  pose.rotation = pose.rotation * quarter_turn;
                  swap_length_and_width(box, pose);
              }),
              "");
}

TEST(BoxConventions, MirroredBoxesAreRecognised) {
    EXPECT_THAT(describe_fault_after([](BoxTrack&, Pose& pose) {
                    pose.translation.y = -pose.translation.y;
                    pose.rotation =
                        glm::dquat(pose.rotation.w, -pose.rotation.x, pose.rotation.y, -pose.rotation.z);
                }),
                HasSubstr("the opposite sign"));
}

TEST(BoxConventions, TheBoxOfTheRecordingVehicleIsLeftOut) {
    Log log = make_street_log({.n_frames = 5, .rows = 8, .columns = 128});
    const std::size_t n_boxes = log.boxes.size();
    const auto add_box_around_sensor = [&](const std::string& id, std::size_t n_around) {
        BoxTrack& box = log.boxes.emplace_back(BoxTrack{id, "Car", {4.5, 1.9, 1.6}, log.world_from_vehicle});
        for (std::size_t k = 0; k < box.world_from_box.pose.size(); ++k)
            box.world_from_box.pose[k].translation += glm::dvec3(k < n_around ? 0.5 : 20.0, 0.0, -1.2);
    };
    add_box_around_sensor("ego", 5);
    add_box_around_sensor("overtaken", 2);
    log.notes.clear();
    checks::remove_ego_boxes(log);
    ASSERT_EQ(log.boxes.size(), n_boxes + 1);
    EXPECT_EQ(log.boxes.back().id, "overtaken");
    EXPECT_THAT(log.notes, testing::ElementsAre(HasSubstr("'ego' (Car, 5 of 5 poses)")));
}

}  // namespace
}  // namespace relidar
