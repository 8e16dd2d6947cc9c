#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Lets actors of a run follow the entities of an OpenSCENARIO XML 1.x file:
  relidar edit run --out cut_in $(tools/examples/openscenario.py cut_in.xosc run paths Van=1 Car=0)

Writes paths/ENTITY.csv for each ENTITY=TRACK and prints the options of `relidar edit`. Insert
actors of other runs first (`relidar edit --insert`). Reads FollowTrajectoryActions in Init, or in
events that a SimulationTimeCondition starts: polylines of timed WorldPositions. The world is the
dataset's, time 0 is the first frame of the log. The boxes of entity and actor have the same bottom.
Without z in all positions of a trajectory, the actor follows the ground.
"""
import json
import math
import pathlib
import sys
from xml.etree import ElementTree


def find_start_s(node):
    """Returns the simulation time at which an act or an event starts."""
    conditions = node.findall("StartTrigger/ConditionGroup/Condition")
    times = [c.find("ByValueCondition/SimulationTimeCondition") for c in conditions]
    if len(times) > 1 or any(t is None or not t.get("rule").startswith("greater") for t in times):
        sys.exit(f"{node.get('name')}: expected one SimulationTimeCondition with the rule greaterThan")
    return float(times[0].get("value")) + float(conditions[0].get("delay", 0)) if times else 0.0


def find_trajectories(root):
    """Yields the entity, the start time and the action of each followed trajectory."""
    for private in root.findall("Storyboard/Init/Actions/Private"):
        yield from ((private.get("entityRef"), 0.0, a) for a in private.iter("FollowTrajectoryAction"))
    for act, group in ((act, group) for act in root.iter("Act") for group in act.iter("ManeuverGroup")):
        for event, action in ((e, a) for e in group.iter("Event") for a in e.iter("FollowTrajectoryAction")):
            for actor in group.findall("Actors/EntityRef"):
                yield actor.get("entityRef"), max(find_start_s(act), find_start_s(event)), action


def read_poses(action, start_s):
    """Returns lists of time, x, y, z, yaw, pitch and roll of the reference point."""
    timing, vertices = action.find("TimeReference/Timing"), action.findall(".//Polyline/Vertex")
    if timing is None or len(vertices) < 2 or any(v.find("Position/WorldPosition") is None for v in vertices):
        sys.exit("expected a Polyline of at least two WorldPositions, and TimeReference/Timing")
    offset_s = float(timing.get("offset", 0)) + start_s * (timing.get("domainAbsoluteRelative") == "relative")
    return [[offset_s + float(timing.get("scale", 1)) * float(v.get("time"))] +
            [float(v.find("Position/WorldPosition").get(key, 0)) for key in "xyzhpr"] for v in vertices]


def turn(angle, a, b):
    return math.cos(angle) * a - math.sin(angle) * b, math.sin(angle) * a + math.cos(angle) * b


def place_boxes(poses, begin_s, offset, parts=10):
    """Yields the poses at `offset` in the frame of each pose, and between them on the arc of a turn."""
    for first, second in zip(poses, poses[1:] + poses[-1:]):
        steps = [b - a for a, b in zip(first, second)]
        steps[4:] = (math.remainder(step, math.tau) for step in steps[4:])
        for part in range(parts if second is not first else 1):
            time_s, x, y, z, *angles = (a + part / parts * step for a, step in zip(first, steps))
            dy, dz = turn(angles[2], *offset[1:])
            dz, dx = turn(angles[1], dz, offset[0])
            dx, dy = turn(angles[0], dx, dy)
            yield begin_s + time_s, x + dx, y + dy, z + dz, *angles


scenario, run, folder, *pairs = sys.argv[1:] if len(sys.argv) > 4 else sys.exit(__doc__)
root, log = ElementTree.parse(scenario).getroot(), json.loads((pathlib.Path(run) / "scene.json").read_text())
parameters = {p.get("name"): p.get("value") for p in root.findall("ParameterDeclarations/*")}
for node in root.iter():
    node.attrib = {k: parameters[v[1:]] if v.startswith("$") else v for k, v in node.items()}
actors, heights_m = dict(p.split("=", 1) for p in pairs), {b["id"]: b["size_m"][2] for b in log["boxes"]}
pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
for entity, start_s, action in (t for t in find_trajectories(root) if t[0] in actors):
    box, track = root.find(f".//ScenarioObject[@name='{entity}']//BoundingBox"), actors.pop(entity)
    x, y, z = (float(box.find("Center").get(key)) for key in "xyz")
    offset = x, y, z + (heights_m[track] - float(box.find("Dimensions").get("height"))) / 2
    rows = place_boxes(read_poses(action, start_s), log["frames"][0]["time_s"], offset)
    if not any("z" in position.attrib for position in action.iter("WorldPosition")):
        rows = ([*row[:3], "ground", *row[4:]] for row in rows)
    text = "\n".join(["time_s,x,y,z,yaw_rad,pitch_rad,roll_rad", *(",".join(map(str, row)) for row in rows)])
    pathlib.Path(folder, f"{entity}.csv").write_text(text + "\n")
    print(f"--trajectory {track}:{folder}/{entity}.csv")
if actors:
    sys.exit(f"{scenario}: no trajectory of {', '.join(actors)}")
