#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares the boxes of the same frames in data sets of different layouts, and in ScanDataset.

  compare_layouts.py DATASET... [--rig RIG.json] [--run RUN --frames FIRST:END]

The data sets are one for each layout, from the same run, sensor and frames, with --fov all. Each frame
of their first sequences must have the same boxes, to 1 mm, with matching classes. RIG.json is the rig
of the sensors; without it, the first sensor is the rig. RUN compares ScanDataset with them; it needs
python3-torch and the module of relidar. Prints the number of boxes, and ends with code 1 at a
difference.
"""
import argparse
import json
import pathlib

import numpy as np
from checks import check, finish
from read_layouts import READERS, pose

TOLERANCE_M = 1e-3
# Names of the classes in the layouts kitti (also openlabel) and nuscenes.
NAMES = {"Car": ({"Car"}, {"vehicle.car"}), "Van": ({"Van"}, {"vehicle.car"}), "Truck": ({"Truck"}, {"vehicle.truck"}),
         "Bus": ({"Misc", "Truck"}, {"vehicle.bus.rigid"}), "Trailer": ({"Misc", "Truck"}, {"vehicle.trailer"}),
         "Cyclist": ({"Cyclist"}, {"vehicle.bicycle"}), "Motorcycle": ({"Cyclist"}, {"vehicle.motorcycle"}),
         "Pedestrian": ({"Pedestrian", "Person_sitting"}, {"human.pedestrian.adult"}),
         "Other": ({"Misc", "Tram"}, {"movable_object.debris"})}


def find_class(name, layout):
    """Returns the classes that a name of a layout can be."""
    column = {"custom": None, "nuscenes": 1}.get(layout, 0)
    return {name} if column is None else {known for known, names in NAMES.items() if name in names[column]}


def read_dataset(folder, rig_from_sensor):
    """Returns the boxes of each frame: centre, size and yaw in the frame of the rig, and classes."""
    layout = json.loads((folder / "dataset.json").read_text())["layout"]
    frames = []
    for _, boxes, world_from_lidar, *_ in READERS[layout](folder, 0):
        to_rig = np.eye(4) if world_from_lidar is None else rig_from_sensor @ np.linalg.inv(world_from_lidar)
        rows = [(to_rig @ m, size, find_class(name, layout)) for m, size, *_, name in boxes]
        frames.append([(np.r_[m[:3, 3], size, np.arctan2(m[1, 0], m[0, 0])], classes) for m, size, classes in rows])
    return f"{folder} ({layout})", frames


def read_run(folder, frames):
    import relidar
    import relidar.torch
    run = relidar.Run.load(folder)
    first, end = map(int, frames.split(":"))
    scans = relidar.torch.ScanDataset(run, classes=list(NAMES), poses=[(time, None) for time in run.times[first:end]])
    found = []
    for scan in scans:
        names = [scans.classes[c] if c >= 0 else "Other" for c in scan["classes"].tolist()]
        found.append([(row, {name}) for row, name in zip(scan["boxes"].numpy().astype(float), names)])
    return f"ScanDataset of {folder}", found


def same_box(row, other):
    turn = (row[6] - other[6] + np.pi) % (2 * np.pi) - np.pi
    return np.abs(row[:6] - other[:6]).max() < TOLERANCE_M and abs(turn) * max(row[3], other[3]) / 2 < TOLERANCE_M


def compare(first, second):
    (name, frames), (other_name, others) = first, second
    check(f"{name} has {len(frames)} frames, {other_name} {len(others)}", len(frames) == len(others))
    for number, (boxes, other_boxes) in enumerate(zip(frames, others)):
        check(f"frame {number}: {name} has {len(boxes)} boxes, {other_name} {len(other_boxes)}", len(boxes) == len(other_boxes))
        for row, classes in boxes:
            match = [other for other in other_boxes if same_box(row, other[0])]
            check(f"frame {number}: the box {np.round(row, 3)} of {name} is not in {other_name}", len(match) == 1)
            check(f"frame {number}: {name} has {classes}, {other_name} {[c for _, c in match]}", all(classes & c for _, c in match))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("datasets", nargs="+", type=pathlib.Path)
    parser.add_argument("--rig", type=pathlib.Path)
    parser.add_argument("--run")
    parser.add_argument("--frames", default="0:1000000")
    options = parser.parse_args()
    sensor = json.loads(options.rig.read_text())["sensors"][0] if options.rig else {}
    rig_from_sensor = pose(np.eye(3), sensor.get("translation_m", [0, 0, 0]))
    sources = [read_dataset(folder, rig_from_sensor) for folder in options.datasets]
    if options.run:
        sources.append(read_run(options.run, options.frames))
    for source in sources[1:]:
        compare(sources[0], source)
    for name, frames in sources:
        print(f"{name}: {len(frames)} frames, {sum(map(len, frames))} boxes")
    check("no boxes", any(map(len, sources[0][1])))
    finish()


if __name__ == "__main__":
    main()
