// SPDX-License-Identifier: Apache-2.0
// Reads trajectories of actors from OpenSCENARIO XML 1.x. Supports
// FollowTrajectoryActions of entities with a bounding box. The trajectory must be a
// polyline whose vertices have a time and a world position.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>
#include <pugixml.hpp>

#include <relidar/base/error.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

// Largest accepted number. Valid coordinates in metres, angles in radians and times in
// seconds are smaller.
constexpr double kMost = 1e10;
// Times that differ by less than this count as equal, because files store times with few
// digits.
constexpr double kSlack_s = 1e-6;

/// An XML document and its parameters. Attributes can refer to a parameter by "$name".
struct ScenarioDocument {
    std::string file;
    std::map<std::string, std::string> parameters;

    [[noreturn]] void fail_at(const std::string& location, const std::string& found_value,
                              const std::string& expected) const {
        fail("{}: {}: found {}, expected {}", file, location, found_value, expected);
    }
    /// Returns the value of an attribute. If the value is "$name", returns the value of
    /// the scenario parameter with this name.
    std::string read_attribute_text(const pugi::xml_node& node, const char* attribute_name,
                                    const std::string& error_location) const {
        const std::string value = node.attribute(attribute_name).value();
        if (!value.starts_with('$')) return value;
        const auto parameter = parameters.find(value.substr(1));
        if (parameter == parameters.end())
            fail_at(fmt::format("{}: {}", error_location, attribute_name),
                    "\"" + shorten_for_error_message(value) + "\"",
                    "a value, or $ followed by the name of a parameter that the scenario declares");
        return parameter->second;
    }
    double read_attribute_number(const pugi::xml_node& node, const char* attribute_name,
                                 const std::string& error_location,
                                 std::optional<double> default_value = {}) const {
        if (default_value && !node.attribute(attribute_name)) return *default_value;
        const std::string value = read_attribute_text(node, attribute_name, error_location);
        const auto number = parse_number(trim_blanks_at_both_ends(value));
        if (!number || !(std::abs(*number) <= kMost))
            fail_at(fmt::format("{}: {}", error_location, attribute_name),
                    "\"" + shorten_for_error_message(value) + "\"",
                    fmt::format("a finite number of at most {:.0e}", kMost));
        return *number;
    }
};

/// Returns the time at which an OpenSCENARIO start trigger fires. This is 0 without a
/// condition, or the simulation time in its condition. Returns nothing for other
/// conditions.
std::optional<double> read_trigger_time_s(const ScenarioDocument& document, const pugi::xml_node& trigger,
                                          const std::string& error_location) {
    const pugi::xml_node group = trigger.child("ConditionGroup"), condition = group.child("Condition");
    if (!condition) return 0.0;
    const pugi::xml_node time = condition.child("ByValueCondition").child("SimulationTimeCondition");
    const std::string rule = time.attribute("rule").value();
    const bool alone = !group.next_sibling("ConditionGroup") && !condition.next_sibling("Condition");
    if (!alone || (rule != "greaterThan" && rule != "greaterOrEqual")) return {};
    return document.read_attribute_number(time, "value", error_location) +
           document.read_attribute_number(condition, "delay", error_location, 0.0);
}

/// An action of an entity, and the time at which it starts. The time is empty if it
/// depends on the simulation.
struct ScenarioAction {
    pugi::xml_node node;  ///< A PrivateAction element of the XML document.
    std::optional<double> start_s;
};
using ActionsByEntity = std::map<std::string, std::vector<ScenarioAction>>;

void append_story_actions(const ScenarioDocument& document, const pugi::xml_node& story,
                          ActionsByEntity& actions_by_entity) {
    for (const pugi::xml_node& act : story.children("Act")) {
        const auto begun = read_trigger_time_s(
            document, act.child("StartTrigger"),
            fmt::format("Act {}", shorten_for_error_message(act.attribute("name").value())));
        for (const pugi::xml_node& group : act.children("ManeuverGroup"))
            for (const pugi::xml_node& maneuver : group.children("Maneuver"))
                for (const pugi::xml_node& event : maneuver.children("Event")) {
                    const std::string where =
                        fmt::format("Event {}", shorten_for_error_message(event.attribute("name").value()));
                    const auto event_start_s =
                        read_trigger_time_s(document, event.child("StartTrigger"), where);
                    const std::optional<double> start_s =
                        begun && event_start_s ? std::optional(std::max(*begun, *event_start_s))
                                               : std::nullopt;
                    for (const pugi::xml_node& action : event.children("Action"))
                        for (const pugi::xml_node& entity : group.child("Actors").children("EntityRef"))
                            if (const pugi::xml_node node = action.child("PrivateAction"))
                                actions_by_entity[document.read_attribute_text(entity, "entityRef", where)]
                                    .push_back({node, start_s});
                }
    }
}

ActionsByEntity read_actions_of_entities(const ScenarioDocument& document, const pugi::xml_node& storyboard) {
    ActionsByEntity actions;
    for (const pugi::xml_node& entity : storyboard.child("Init").child("Actions").children("Private"))
        for (const pugi::xml_node& node : entity.children("PrivateAction"))
            actions[document.read_attribute_text(entity, "entityRef", "Init")].push_back({node, 0.0});
    for (const pugi::xml_node& story : storyboard.children("Story"))
        append_story_actions(document, story, actions);
    return actions;
}

/// Offset and scale that convert the times of an action to times of the scenario.
struct ScenarioTiming {
    double offset_s = 0.0, scale = 1.0;
};

ScenarioTiming read_trajectory_timing(const ScenarioDocument& document, const pugi::xml_node& action,
                                      std::optional<double> action_start_s,
                                      const std::string& error_location) {
    const pugi::xml_node timing = action.child("TimeReference").child("Timing");
    if (!timing)
        document.fail_at(
            error_location, "no element TimeReference/Timing",
            "the element TimeReference/Timing, because the times of vertices have no meaning without it");
    if (!action_start_s)
        document.fail_at(error_location, "a trajectory that starts with an unsupported condition",
                         "a single SimulationTimeCondition with the rule greaterThan, or no condition");
    const std::string domain = document.read_attribute_text(timing, "domainAbsoluteRelative", error_location);
    if (domain != "absolute" && domain != "relative")
        document.fail_at(error_location + ": domainAbsoluteRelative",
                         "\"" + shorten_for_error_message(domain) + "\"", "the text absolute or relative");
    const double scale = document.read_attribute_number(timing, "scale", error_location, 1.0);
    if (!(scale > 0.0))
        document.fail_at(error_location + ": scale", fmt::format("{}", scale), "a number above 0");
    return {document.read_attribute_number(timing, "offset", error_location, 0.0) +
                (domain == "relative" ? *action_start_s : 0.0),
            scale};
}

Pose read_vertex_pose(const ScenarioDocument& document, const pugi::xml_node& vertex,
                      const std::string& error_location) {
    const pugi::xml_node kind = vertex.child("Position").first_child(),
                         world = vertex.child("Position").child("WorldPosition");
    if (!world)
        document.fail_at(error_location,
                         kind ? "a " + shorten_for_error_message(kind.name()) : "no element Position",
                         "a WorldPosition");
    const auto get = [&](const char* name, std::optional<double> default_value) {
        return document.read_attribute_number(world, name, error_location, default_value);
    };
    return {make_rotation(get("h", 0.0), get("p", 0.0), get("r", 0.0)),
            {get("x", {}), get("y", {}), get("z", 0.0)}};
}

PoseTrack read_polyline_trajectory(const ScenarioDocument& document, const ScenarioAction& action,
                                   const std::string& error_location) {
    const pugi::xml_node follow = action.node.child("RoutingAction").child("FollowTrajectoryAction");
    // In OpenSCENARIO 1.1 and later, the trajectory is a child of TrajectoryRef. In
    // OpenSCENARIO 1.0, the trajectory is a child of the action.
    pugi::xml_node trajectory = follow.child("TrajectoryRef").child("Trajectory");
    if (!trajectory) trajectory = follow.child("Trajectory");
    if (!trajectory)
        document.fail_at(error_location, "no element Trajectory",
                         "an element Trajectory in this file; relidar does not read catalogs");
    const pugi::xml_node polyline = trajectory.child("Shape").child("Polyline"),
                         other = trajectory.child("Shape").first_child();
    if (!polyline)
        document.fail_at(error_location,
                         other ? "a " + shorten_for_error_message(other.name()) : "no element Shape",
                         "a Polyline");
    if (document.read_attribute_text(trajectory, "closed", error_location) == "true")
        document.fail_at(error_location, "a closed trajectory", "a trajectory with closed=\"false\"");
    if (document.read_attribute_number(follow, "initialDistanceOffset", error_location, 0.0) != 0.0)
        document.fail_at(error_location, "an initialDistanceOffset",
                         "an offset of 0, because a trajectory can only be followed from its first vertex");
    const ScenarioTiming timing = read_trajectory_timing(document, follow, action.start_s, error_location);
    PoseTrack track;
    for (const pugi::xml_node& vertex : polyline.children("Vertex")) {
        const std::string at = fmt::format("{}: Vertex {}", error_location, track.pose.size() + 1);
        const double time_s =
            timing.offset_s + timing.scale * document.read_attribute_number(vertex, "time", at);
        if (!track.time_s.empty() && !(time_s > track.time_s.back()))
            document.fail_at(at + ": time", fmt::format("{} s after {} s", time_s, track.time_s.back()),
                             "increasing times");
        track.time_s.push_back(time_s);
        track.pose.push_back(read_vertex_pose(document, vertex, at));
    }
    if (track.pose.size() < 2)
        document.fail_at(error_location, fmt::format("{} vertices", track.pose.size()),
                         "at least two vertices");
    if (*action.start_s > track.time_s.front() + kSlack_s)
        document.fail_at(error_location,
                         fmt::format("a start time of {} s, which is after the time {} s of the first vertex",
                                     *action.start_s, track.time_s.front()),
                         "a start time at or before the time of the first vertex");
    return track;
}

void read_bounding_box(const ScenarioDocument& document, const pugi::xml_node& object,
                       const std::string& error_location, ScenarioEntity& entity) {
    pugi::xml_node box;
    for (const char* kind : {"Vehicle", "Pedestrian", "MiscObject"})
        if (!box) box = object.child(kind).child("BoundingBox");
    if (!box)
        document.fail_at(error_location, "no element BoundingBox",
                         "a BoundingBox in this file, which gives the size of the box and its offset from "
                         "the reference point of the trajectory");
    const pugi::xml_node centre = box.child("Center"), size = box.child("Dimensions");
    entity.centre_m = {document.read_attribute_number(centre, "x", error_location),
                       document.read_attribute_number(centre, "y", error_location),
                       document.read_attribute_number(centre, "z", error_location)};
    entity.size_m = {document.read_attribute_number(size, "length", error_location),
                     document.read_attribute_number(size, "width", error_location),
                     document.read_attribute_number(size, "height", error_location)};
}

ScenarioEntity read_scenario_entity(const ScenarioDocument& document, const pugi::xml_node& object,
                                    const std::vector<ScenarioAction>& actions) {
    ScenarioEntity entity;
    entity.name = object.attribute("name").value();
    const std::string where = fmt::format("entity {}", shorten_for_error_message(entity.name));
    for (const ScenarioAction& action : actions) {
        const pugi::xml_node kind = action.node.first_child();
        if (!kind.child("FollowTrajectoryAction")) {
            entity.ignored.emplace_back(shorten_for_error_message(kind.name()));
            continue;
        }
        if (!entity.world_from_reference.pose.empty())
            document.fail_at(where, "a second trajectory", "at most one trajectory");
        entity.world_from_reference = read_polyline_trajectory(document, action, where);
    }
    if (!entity.world_from_reference.pose.empty()) read_bounding_box(document, object, where, entity);
    return entity;
}

}  // namespace

std::vector<ScenarioEntity> read_openscenario_entities(const std::filesystem::path& path) {
    const std::string text = read_text_file(path);
    pugi::xml_document document;
    const pugi::xml_parse_result parsed = document.load_buffer(text.data(), text.size());
    if (!parsed)
        fail("{}: malformed XML at byte {}: {}", path.string(), parsed.offset, parsed.description());
    const pugi::xml_node root = document.child("OpenSCENARIO");
    if (!root.child("Storyboard"))
        fail(
            "{}: the element OpenSCENARIO/Storyboard is missing, expected a scenario in OpenSCENARIO XML 1.x",
            path.string());
    ScenarioDocument source{path.string(), {}};
    for (const pugi::xml_node& parameter :
         root.child("ParameterDeclarations").children("ParameterDeclaration"))
        source.parameters.emplace(parameter.attribute("name").value(), parameter.attribute("value").value());
    ActionsByEntity actions = read_actions_of_entities(source, root.child("Storyboard"));
    std::vector<ScenarioEntity> entities;
    for (const pugi::xml_node& object : root.child("Entities").children("ScenarioObject")) {
        const auto entity_actions = actions.extract(object.attribute("name").value());
        entities.push_back(read_scenario_entity(
            source, object, entity_actions ? entity_actions.mapped() : std::vector<ScenarioAction>()));
    }
    if (!actions.empty())
        source.fail_at("Storyboard",
                       fmt::format("actions of the undefined entity \"{}\"",
                                   shorten_for_error_message(actions.begin()->first)),
                       "a ScenarioObject with that name in the list of entities");
    return entities;
}

PoseTrack convert_to_box_track(const ScenarioEntity& entity, double scenario_start_s,
                               const glm::dvec3& box_size_m) {
    const glm::dvec3 centre_m(entity.centre_m.x, entity.centre_m.y,
                              entity.centre_m.z - 0.5 * entity.size_m.z + 0.5 * box_size_m.z);
    PoseTrack track = compute_mounted_track(subdivide_turning_segments(entity.world_from_reference),
                                            {{1, 0, 0, 0}, centre_m});
    for (double& time_s : track.time_s) time_s += scenario_start_s;
    return track;
}

}  // namespace relidar
