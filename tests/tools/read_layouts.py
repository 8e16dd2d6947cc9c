#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Reads data sets with numpy and the published descriptions of their layouts only. It uses no code
of relidar.

  read_layouts.py LAYOUT FOLDER SEQUENCE [TRUTH RIG.json]

Checks the files of a sequence, then compares its boxes with those of TRUTH: a rendering of the same
rig with --boxes. Each object within 60 m that a sensor of TRUTH hits must have exactly one box in
each frame, at the same pose, with points near it, and no other box may exist. Prints the numbers of
objects and errors, and exits with code 1 if a check fails.
"""
import json
import pathlib
import struct
import sys

import numpy as np
from checks import check, failures

MAX_RANGE_M = 60.0
CAMERA_FROM_VELO = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], float)
TABLES = ["attribute", "calibrated_sensor", "category", "ego_pose", "instance", "log", "map", "sample",
          "sample_annotation", "sample_data", "scene", "sensor", "visibility"]


def rotation(w, x, y, z):
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def pose(turn, position):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, position
    return matrix


def count_inside(points, world_from_box, size):
    local = (points - world_from_box[:3, 3]) @ world_from_box[:3, :3]
    return int((np.abs(local) <= np.asarray(size) / 2 + 1e-4).all(axis=1).sum())


def read_kitti(folder, sequence):
    """Returns the points of each frame and its boxes: pose, size (length, width, height) and class, in the
    frame of the rig. The third value is None: the pose of the rig in the world is unknown."""
    tracks = (folder / f"tracking/training/label_02/{sequence:04}.txt").read_text().splitlines()
    first = sum(s["frames"] for s in json.loads((folder / "dataset.json").read_text())["sequences"][:sequence])
    frames = []
    listed = sum(((folder / f"ImageSets/{split}.txt").read_text().split() for split in ("train", "val")), [])
    check("ImageSets: not each frame once", sorted(listed) == [f"{i:06}" for i in range(len(listed))])
    for index, file in enumerate(sorted((folder / f"tracking/training/velodyne/{sequence:04}").iterdir())):
        name = f"{first + index:06}"
        points = np.fromfile(folder / f"training/velodyne/{name}.bin", "<f4").reshape(-1, 4)
        check(f"{file}: other points", points.tobytes() == file.read_bytes())
        calib = dict(line.split(":") for line in (folder / f"training/calib/{name}.txt").read_text().splitlines())
        matrix = np.array(calib["Tr_velo_to_cam"].split(), float).reshape(3, 4)
        check(f"{name}: calibration", np.array_equal(matrix[:, :3], CAMERA_FROM_VELO) and not matrix[:, 3].any())
        check(f"{name}: R0_rect", len(calib["R0_rect"].split()) == 9 and len(calib["P2"].split()) == 12)
        boxes = []
        labels = (folder / f"training/label_2/{name}.txt").read_text().splitlines()
        tracked = [line.split() for line in tracks if line.split()[0] == str(index)]
        check(f"{name}: other tracking labels", [t[2:3] + t[4:] for t in tracked] == [
            line.split()[:1] + line.split()[2:] for line in labels])
        check(f"{name}: a track occurs twice", len({t[1] for t in tracked}) == len(tracked))
        for line in labels:
            words = line.split()
            truncated, occluded, alpha, *numbers = map(float, words[1:])
            height, width, length, x, y, z, turn = numbers[4:]
            check(f"{name}: {line}", len(words) == 15 and 0 <= truncated <= 1 and occluded in (0, 1, 2, 3))
            seen_from = (alpha - turn + np.arctan2(x, z)) / (2 * np.pi)
            check(f"{name}: alpha of {line}", abs(seen_from - round(seen_from)) < 1e-4)
            c, s = np.cos(turn), np.sin(turn)   # turn about the y axis, which points down
            # Axes of the box in the camera: length, width (left), height (up).
            axes = np.array([[c, 0, -s], [s, 0, c], [0, -1, 0]]).T
            centre = np.array([x, y - height / 2, z])
            boxes.append((pose(CAMERA_FROM_VELO.T @ axes, CAMERA_FROM_VELO.T @ centre), (length, width, height), words[0]))
        frames.append((points[:, :3], boxes, None))
    return frames


def read_nuscenes(folder, sequence):
    """Like read_kitti(), in the world. Checks that all keys refer to records, and all chains. The third
    value is the pose of LIDAR_TOP, with x forward."""
    version = folder / "v1.0-trainval"
    table = {name: {r["token"]: r for r in json.loads((version / f"{name}.json").read_text())} for name in TABLES}
    for name, records in table.items():
        for record in records.values():
            for key, value in record.items():
                target = {"first_sample": "sample", "last_sample": "sample", "first_annotation": "sample_annotation",
                          "last_annotation": "sample_annotation"}.get(key[:-6], key[:-6])
                if key.endswith("_token") and not (key == "visibility_token" and not value):
                    check(f"{name}: {key} {value}", value in table[target])
                for token in value if key.endswith("_tokens") else []:
                    check(f"{name}: {key} {token}", token in table[key[:-7]])
                if key in ("prev", "next") and value:
                    other = {"prev": "next", "next": "prev"}[key]
                    check(f"{name}: {key} of {record['token']}", records[value][other] == record["token"])
    check("map: not each log once", sorted(sum((m["log_tokens"] for m in table["map"].values()), [])) == sorted(table["log"]))
    for instance in table["instance"].values():
        chain, token = [], instance["first_annotation_token"]
        while token:
            chain.append(token)
            token = table["sample_annotation"][token]["next"]
        check("instance: its chain", len(chain) == instance["nbr_annotations"] and chain[-1] == instance["last_annotation_token"]
              and all(table["sample_annotation"][a]["instance_token"] == instance["token"] for a in chain))
    # The scenes have the order of the sequences. Sequence 0 has a scene in both splits, if it has two frames.
    sequences = json.loads((folder / "dataset.json").read_text())["sequences"]
    scenes, position = list(table["scene"].values()), 0
    for number in range(sequence + 1):
        scenes, position = scenes[position:], 1 + (number == 0 and sequences[0]["frames"] > 1)
    scenes = scenes[:position]
    check("scenes: not the frames of the sequence", sum(s["nbr_samples"] for s in scenes) == sequences[sequence]["frames"])
    splits = json.loads((version / "splits.json").read_text())
    check("splits: not each scene once", sorted(splits["train"] + splits["val"]) == sorted(s["name"] for s in table["scene"].values()))
    check("splits: no scene for validation", splits["train"] and (splits["val"] or sequences[0]["frames"] == 1))
    return sum((read_scene(folder, table, scene) for scene in scenes), [])


def read_scene(folder, table, scene):
    frames, token = [], scene["first_sample_token"]
    while token:
        sample = table["sample"][token]
        check("sample: another scene", sample["scene_token"] == scene["token"])
        points, from_lidar = [], []
        for data in table["sample_data"].values():
            if data["sample_token"] != token:
                continue
            check("sample_data: time", data["is_key_frame"] and data["timestamp"] == sample["timestamp"])
            mount = table["calibrated_sensor"][data["calibrated_sensor_token"]]
            ego = table["ego_pose"][data["ego_pose_token"]]
            channel = table["sensor"][mount["sensor_token"]]["channel"]
            to_world = pose(rotation(*ego["rotation"]), ego["translation"]) @ pose(
                rotation(*mount["rotation"]), mount["translation"])
            if channel == "LIDAR_TOP":   # x right, y forward
                world_from_lidar = to_world @ pose(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], float), [0, 0, 0])
            cloud = np.fromfile(folder / data["filename"], "<f4").reshape(-1, 5)
            slope = cloud[:, 2] / np.hypot(cloud[:, 0], cloud[:, 1])
            of_rings = [np.median(slope[cloud[:, 4] == ring]) for ring in np.unique(cloud[:, 4])]
            check("rings: not from the lowest to the highest", (np.diff(of_rings) > 0).all())
            points.append(cloud[:, :3] @ to_world[:3, :3].T + to_world[:3, 3])
            from_lidar.append(channel)
        check(f"channels {from_lidar}", len(set(from_lidar)) == len(from_lidar) and "LIDAR_TOP" in from_lidar)
        points = np.concatenate(points)
        boxes = []
        for a in table["sample_annotation"].values():
            if a["sample_token"] == token:
                width, length, height = a["size"]
                category = table["category"][table["instance"][a["instance_token"]]["category_token"]]["name"]
                boxes.append((pose(rotation(*a["rotation"]), a["translation"]), (length, width, height), category))
                # Points of the object can be outside of its box, and ground is in the lowest part.
                least, most = (count_inside(points, boxes[-1][0], np.add(boxes[-1][1], m)) for m in (-0.3, 1.0))
                check("num_lidar_pts", max(least, 1) <= a["num_lidar_pts"] <= most)
        frames.append((points, boxes, world_from_lidar))
        token = sample["next"]
    check("scene: number of samples", len(frames) == scene["nbr_samples"] and sample["token"] == scene["last_sample_token"])
    return frames


def read_openlabel(folder, sequence):
    """Like read_kitti(). Compares the labels of points with the boxes."""
    folder = folder / f"sequences/{sequence:02}"
    root = json.loads((folder / "openlabel.json").read_text())["openlabel"]
    check("openlabel: metadata", root["metadata"]["schema_version"] == "1.0.0")
    for name, system in root["coordinate_systems"].items():
        check(f"openlabel: parent of {name}", not system["parent"] or name in root["coordinate_systems"][system["parent"]]["children"])
    frames = []
    for key, frame in sorted(root["frames"].items(), key=lambda entry: int(entry[0])):
        points = np.fromfile(folder / frame["frame_properties"]["streams"]["lidar"]["uri"], "<f4").reshape(-1, 4)
        labels = np.fromfile(folder / f"labels/{int(key):06}.label", "<u4")
        check(f"{key}: labels", len(labels) == len(points))
        boxes = []
        check(f"{key}: an object has points or a box, but not both",
              set(labels >> 16) - {0} == {int(number) + 1 for number in frame["objects"]})
        for number, data in frame["objects"].items():
            known = root["objects"][number]
            check(f"{key}: interval of {number}", any(
                i["frame_start"] <= int(key) <= i["frame_end"] for i in known["frame_intervals"]))
            (cuboid,) = data["object_data"]["cuboid"]
            x, y, z, qx, qy, qz, qw, *size = cuboid["val"]
            boxes.append((pose(rotation(qw, qx, qy, qz), (x, y, z)), size, known["type"]))
            of_object = labels >> 16 == int(number) + 1
            away = count_inside(points[of_object, :3], boxes[-1][0], np.add(size, 1.0))
            check(f"{key}: points of {number} are outside", of_object.any() and away >= 0.95 * of_object.sum())
            check(f"{key}: class of {number}", len(set(labels[of_object] & 0xFFFF)) == 1)
        frames.append((points[:, :3], boxes, None))
    check("openlabel: frames", len(frames) == len((folder / "poses.txt").read_text().splitlines()))
    return frames


def read_custom(folder, sequence):
    """Like read_kitti()."""
    counts = [s["frames"] for s in json.loads((folder / "dataset.json").read_text())["sequences"]]
    listed = {split: (folder / f"ImageSets/{split}.txt").read_text().split() for split in ("train", "val")}
    with_boxes = [f.stem for f in sorted((folder / "labels").iterdir()) if f.read_text()]
    check("ImageSets: not each frame with a box once", sorted(listed["train"] + listed["val"]) == with_boxes)
    check("ImageSets: no frame for validation", listed["val"] or counts[0] == 1)
    frames = []
    for number in range(sum(counts[:sequence]), sum(counts[:sequence + 1])):
        points = np.load(folder / f"points/{number:06}.npy")
        check(f"{number}: x y z intensity", points.dtype == np.float32 and points.shape[1] == 4 and points[:, 3].max() <= 1)
        check(f"{number}: other points", points.tobytes() == (folder / f"points/{number:06}.bin").read_bytes())
        boxes = []
        for line in (folder / f"labels/{number:06}.txt").read_text().splitlines():
            *numbers, name = line.split()
            x, y, z, length, width, height, heading = map(float, numbers)
            turn = rotation(np.cos(heading / 2), 0, 0, np.sin(heading / 2))
            boxes.append((pose(turn, (x, y, z)), (length, width, height), name))
        frames.append((points[:, :3], boxes, None))
    return frames


READERS = {"kitti": read_kitti, "nuscenes": read_nuscenes, "openlabel": read_openlabel, "custom": read_custom}


def read_truth(folder, rig):
    """Returns the expected boxes of each frame, in the world, and the poses of the rig."""
    sensors = json.loads(pathlib.Path(rig).read_text())["sensors"]
    scans = [json.loads((folder / s["name"] / "scans.json").read_text())["scans"] for s in sensors]
    frames = []
    for entries in zip(*scans):
        best = {}
        for entry in entries:
            for box in entry["boxes"]:
                if box["points"] > best.get(box["track"], {"points": 0})["points"]:
                    best[box["track"]] = box
        world_from_rig = np.array(entries[0]["world_from_sensor"]) @ pose(
            np.eye(3), -np.array(sensors[0].get("translation_m", [0, 0, 0]), float))   # the first sensor is not turned
        frames.append((world_from_rig, [(np.array(b["world_from_box"]), b["size_m"]) for b in best.values()]))
    return frames


def main():
    layout, folder, sequence, *truth = sys.argv[1:]
    frames = READERS[layout](pathlib.Path(folder), int(sequence))
    n_boxes = sum(len(boxes) for _, boxes, _ in frames)
    print(f"{layout}: {len(frames)} frames, {n_boxes} boxes")
    empty = sum(count_inside(points, m, np.add(size, 1.0)) == 0 for points, boxes, _ in frames for m, size, _ in boxes)
    check(f"{empty} boxes without points", empty == 0)
    if truth:
        n_expected = n_found = n_near = 0
        for (_, boxes, world_from_lidar), (world_from_rig, expected) in zip(frames, read_truth(pathlib.Path(truth[0]), truth[1])):
            is_local = world_from_lidar is None
            to_frame = np.linalg.inv(world_from_rig) if is_local else np.eye(4)
            centre = np.zeros(3) if is_local else world_from_rig[:3, 3]
            near = [(m, s) for m, s, _ in boxes if np.linalg.norm(m[:3, 3] - centre) < MAX_RANGE_M]
            n_near += len(near)
            for world_from_box, size in expected:
                box = to_frame @ world_from_box
                if np.linalg.norm(box[:3, 3] - centre) >= MAX_RANGE_M:
                    continue
                n_expected += 1
                n_found += sum(np.abs(m - box)[:3, 3].max() < 2e-3 and np.allclose(s, size, atol=1e-3)
                               and m[:3, 0] @ box[:3, 0] > 0.99 for m, s in near) == 1
        print(f"objects within {MAX_RANGE_M:.0f} m: {n_expected}, with one box: {n_found}, boxes: {n_near}")
        check("recall or precision below 1", n_expected == n_found == n_near > 0)
    print("\n".join(failures[:20]))
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
