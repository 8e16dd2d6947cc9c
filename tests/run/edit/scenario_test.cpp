// SPDX-License-Identifier: Apache-2.0
// Tests OpenSCENARIO files. Compares entities and their trajectories with values computed
// by hand. Also tests the errors for unsupported or invalid trajectories.
#include <relidar/run/edit.hpp>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using test::Names;

std::string replace_text(std::string text, const std::string& description, const std::string& replacement) {
    const std::size_t at = text.find(description);
    EXPECT_NE(at, std::string::npos) << description;
    return at == std::string::npos ? text : text.replace(at, description.size(), replacement);
}

/// Scenario with three entities. A van turns left at 10 m/s from Init. A car starts 2 s
/// after the act, which starts at 1 s. A third entity has no actions.
const std::string kScenario = R"(<?xml version="1.0" encoding="UTF-8"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="2" date="2024-01-01T00:00:00" description="" author=""/>
  <ParameterDeclarations><ParameterDeclaration name="Lane" parameterType="double" value="-3.5"/></ParameterDeclarations>
  <Entities>
    <ScenarioObject name="Van"><Vehicle name="van" vehicleCategory="van">
      <BoundingBox><Center x="1.5" y="0.0" z="1.0"/><Dimensions width="2.0" length="5.0" height="2.0"/></BoundingBox>
    </Vehicle></ScenarioObject>
    <ScenarioObject name="Car"><Vehicle name="car" vehicleCategory="car">
      <BoundingBox><Center x="1.2" y="0.1" z="0.7"/><Dimensions width="1.8" length="4.2" height="1.4"/></BoundingBox>
    </Vehicle></ScenarioObject>
    <ScenarioObject name="Ego"><CatalogReference catalogName="c" entryName="e"/></ScenarioObject>
  </Entities>
  <Storyboard>
    <Init><Actions>
      <Private entityRef="Van">
        <PrivateAction><TeleportAction><Position><WorldPosition x="0" y="0"/></Position></TeleportAction></PrivateAction>
        <PrivateAction><RoutingAction><FollowTrajectoryAction>
          <TrajectoryRef><Trajectory name="t" closed="false"><ParameterDeclarations/><Shape><Polyline>
            <Vertex time="0.0"><Position><WorldPosition x="10.0" y="$Lane" z="0.5" h="0.0"/></Position></Vertex>
            <Vertex time="1.0"><Position>
              <WorldPosition x="20.0" y="$Lane" z="0.5" h="1.5707963267948966" p="0.1" r="0.2"/></Position></Vertex>
          </Polyline></Shape></Trajectory></TrajectoryRef>
          <TimeReference><Timing domainAbsoluteRelative="absolute" scale="2.0" offset="0.25"/></TimeReference>
          <TrajectoryFollowingMode followingMode="position"/>
        </FollowTrajectoryAction></RoutingAction></PrivateAction>
      </Private>
      <Private entityRef="Ego"><PrivateAction><LongitudinalAction><SpeedAction/></LongitudinalAction></PrivateAction></Private>
    </Actions></Init>
    <Story name="s"><Act name="a">
      <ManeuverGroup name="g" maximumExecutionCount="1"><Actors selectTriggeringEntities="false"><EntityRef entityRef="Car"/></Actors>
        <Maneuver name="m"><Event name="e" priority="overwrite">
          <Action name="x"><PrivateAction><RoutingAction><FollowTrajectoryAction>
            <Trajectory name="u" closed="false"><Shape><Polyline>
              <Vertex time="0.0"><Position><WorldPosition x="0" y="1" z="0" h="0"/></Position></Vertex>
              <Vertex time="4.0"><Position><WorldPosition x="8" y="1" z="0" h="0"/></Position></Vertex>
            </Polyline></Shape></Trajectory>
            <TimeReference><Timing domainAbsoluteRelative="relative" scale="1.0" offset="0.5"/></TimeReference>
          </FollowTrajectoryAction></RoutingAction></PrivateAction></Action>
          <StartTrigger><ConditionGroup><Condition name="c" delay="1.0" conditionEdge="rising"><ByValueCondition>
            <SimulationTimeCondition value="2.0" rule="greaterThan"/></ByValueCondition></Condition></ConditionGroup></StartTrigger>
        </Event></Maneuver></ManeuverGroup>
      <StartTrigger><ConditionGroup><Condition name="d" delay="0" conditionEdge="rising"><ByValueCondition>
        <SimulationTimeCondition value="1.0" rule="greaterThan"/></ByValueCondition></Condition></ConditionGroup></StartTrigger>
    </Act></Story>
  </Storyboard>
</OpenSCENARIO>
)";

class Scenario : public TemporaryFolder {
protected:
    std::vector<ScenarioEntity> read(const std::string& text) {
        put(folder / "s.xosc", text);
        return read_openscenario_entities(folder / "s.xosc");
    }
    std::string error(const std::string& description, const std::string& replacement) {
        return get_data_error_message([&] { read(replace_text(kScenario, description, replacement)); });
    }
};

TEST_F(Scenario, EntitiesFollowTheirPolylinesAtTheirTimes) {
    const std::vector<ScenarioEntity> entities = read(kScenario);
    ASSERT_EQ(entities.size(), 3u);
    const ScenarioEntity &van = entities[0], &car = entities[1], &ego = entities[2];
    EXPECT_EQ(van.name, "Van");
    EXPECT_THAT(van.world_from_reference.time_s, testing::ElementsAre(0.25, 2.25))
        << "twice as slow, a quarter of a second later";
    EXPECT_EQ(van.world_from_reference.pose[1].translation, glm::dvec3(20.0, -3.5, 0.5));
    const glm::dquat expected = make_rotation(kPi / 2, 0.1, 0.2);
    EXPECT_GT(std::abs(glm::dot(van.world_from_reference.pose[1].rotation, expected)), 1.0 - 1e-12);
    EXPECT_THAT(van.ignored, testing::ElementsAre("TeleportAction"));
    EXPECT_EQ(van.size_m, glm::dvec3(5.0, 2.0, 2.0));
    EXPECT_THAT(car.world_from_reference.time_s, testing::ElementsAre(3.5, 7.5))
        << "2 s and a delay of 1 s, and half a second of offset";
    EXPECT_EQ(car.world_from_reference.pose[1].translation, glm::dvec3(8.0, 1.0, 0.0));
    EXPECT_TRUE(ego.world_from_reference.pose.empty());
    EXPECT_THAT(ego.ignored, testing::ElementsAre("LongitudinalAction"));
}

/// The reference point of an entity is below the middle of the rear axle. The box of the
/// actor must have the same position as the box of the entity, although the actor is half
/// a metre lower.
TEST_F(Scenario, ActorsStandWhereTheBoxOfTheEntityDoes) {
    const ScenarioEntity van = read(kScenario)[0];
    const PoseTrack track = convert_to_box_track(van, 100.0, {4.0, 1.8, 1.5});
    EXPECT_DOUBLE_EQ(track.time_s.front(), 100.25);
    EXPECT_DOUBLE_EQ(track.time_s.back(), 102.25);
    EXPECT_LT(glm::distance(track.pose.front().translation, glm::dvec3(11.5, -3.5, 0.5 + 0.75)), 1e-12);
    // time at 45 degrees of the turn, for a point 1.5 m ahead of the rear axle
    const double halfway_s = 101.25;
    const Pose axle = van.world_from_reference.interpolate_pose(halfway_s - 100.0);
    EXPECT_LT(glm::distance(track.interpolate_pose(halfway_s).translation, axle * glm::dvec3(1.5, 0.0, 0.75)),
              5e-3);
}

TEST_F(Scenario, WhatATrajectoryMayNotBeIsNamed) {
    const auto says = [](const char* text) { return Names(text); };
    EXPECT_THAT(error("<Storyboard>", "<Story"), says("s.xosc ... malformed"));
    EXPECT_THAT(get_data_error_message([&] { read("<OpenSCENARIO/>"); }), says("OpenSCENARIO XML 1.x"));
    EXPECT_THAT(error("x=\"20.0\"", "x=\"2O\""), says("Van: Vertex 2: x ... \"2O\" ... finite"));
    EXPECT_THAT(error("x=\"20.0\"", ""), says("entity Van: Vertex 2: x: found \"\""));
    EXPECT_THAT(error("$Lane", "$Line"), says("Van: Vertex 1: y ... \"$Line\" ... $"));
    EXPECT_THAT(error("<Vertex time=\"1.0\"", "<Vertex time=\"0.0\""),
                says("Vertex 2: time: found 0.25 s after 0.25 s, expected"));
    EXPECT_THAT(error("<Vertex time=\"1.0\"", "<Vertex"), says("entity Van: Vertex 2: time: found \"\""));
    EXPECT_THAT(
        error("<WorldPosition x=\"10.0\" y=\"$Lane\" z=\"0.5\" h=\"0.0\"/>", "<LanePosition roadId=\"1\"/>"),
        says("entity Van: Vertex 1: found a LanePosition, expected a WorldPosition"));
    EXPECT_THAT(error("<ParameterDeclarations/><Shape>", "<Shape><Nurbs order=\"3\"/></Shape><Shape>"),
                says("Van ... Nurbs ... Polyline"));
    EXPECT_THAT(error("closed=\"false\"", "closed=\"true\""), says("closed"));
    EXPECT_THAT(
        error("<Timing domainAbsoluteRelative=\"absolute\" scale=\"2.0\" offset=\"0.25\"/>", "<None/>"),
        says("Van ... TimeReference/Timing"));
    EXPECT_THAT(error("scale=\"2.0\"", "scale=\"0\""), says("entity Van: scale: found 0"));
    EXPECT_THAT(error("domainAbsoluteRelative=\"absolute\"", "domainAbsoluteRelative=\"both\""),
                says("absolute or relative"));
    EXPECT_THAT(error("rule=\"greaterThan\"", "rule=\"lessThan\""), says("Car ... condition"));
    EXPECT_THAT(error("domainAbsoluteRelative=\"relative\"", "domainAbsoluteRelative=\"absolute\""),
                says("Car ... 3 s ... 0.5 s"));
    EXPECT_THAT(error("entityRef=\"Car\"", "entityRef=\"Cab\""), says("\"Cab\" ... ScenarioObject"));
    EXPECT_THAT(error("entityRef=\"Car\"", "entityRef=\"Van\""), says("Van ... second trajectory"));
    EXPECT_THAT(error("entityRef=\"Car\"", "entityRef=\"Ego\""), says("Ego ... BoundingBox"));
}

}  // namespace
}  // namespace relidar
