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
CAMERAS = sorted("CAM_" + name for name in ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "BACK", "BACK_LEFT", "BACK_RIGHT"))
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


def corners_of(size):
    return np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size


def project(matrix, points):
    """Returns the pixels of points in front of the camera, and which points these are."""
    u, v, w = matrix[:, :3] @ points.T + matrix[:, 3:]
    front = w > 0
    return np.stack([u[front] / w[front], v[front] / w[front]], 1), front


def rectangle(matrix, corners, columns, rows):
    """Returns the rectangle around projected corners and its truncation. Only for a box in front of the camera."""
    pixels, _ = project(matrix, corners)
    low, high = pixels.min(0), pixels.max(0)
    clipped = np.concatenate([np.maximum(low, 0), np.minimum(high, [columns - 1, rows - 1])])
    side = np.maximum(clipped[2:] - clipped[:2], 0)
    return clipped, 1 - side.prod() / (high - low).prod()


def png_size(file):
    """Returns columns, rows, bits and colour type: 0 gray, 2 RGB."""
    data = file.read_bytes()
    check(f"{file}: PNG", data[:8] == b"\x89PNG\r\n\x1a\n")
    return struct.unpack(">IIBB", data[16:26])


def read_oxts(file):
    """Returns the poses as the development kit of KITTI raw computes them, relative to the first."""
    lines = np.loadtxt(file, ndmin=2)
    check(f"{file}: 30 columns", lines.shape[1] == 30)
    scale, radius, poses = np.cos(np.radians(lines[0, 0])), 6378137.0, []
    for lat, lon, height, roll, pitch, yaw in lines[:, :6]:
        (a, b, c), (d, e, f) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
        turn = (np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]]) @ [[b, 0, e], [0, 1, 0], [-e, 0, b]] @ [[1, 0, 0], [0, a, -d], [0, d, a]])
        poses.append(pose(turn, [scale * np.radians(lon) * radius, scale * radius * np.log(np.tan(np.radians(90 + lat) / 2)), height]))
    return [np.linalg.inv(poses[0]) @ p for p in poses], lines


def read_kitti(folder, sequence):
    """Returns the points of each frame and its boxes: pose, size (length, width, height), ..., class, in the
    frame of the rig. The third value of a frame is None: the pose of the rig in the world is unknown."""
    tracking = folder / "tracking/training"
    tracks = (tracking / f"label_02/{sequence:04}.txt").read_text().splitlines()
    index_of_data_set = json.loads((folder / "dataset.json").read_text())["sequences"]
    first, settings = sum(s["frames"] for s in index_of_data_set[:sequence]), index_of_data_set[sequence]["settings"]
    has_pictures, fov = "black" not in settings["camera"], settings["fov"]
    frames = []
    sets = {split: (folder / f"ImageSets/{split}.txt").read_text().split() for split in ("train", "val", "trainval", "test")}
    everything = [f"{i:06}" for i in range(sum(s["frames"] for s in index_of_data_set))]
    check("ImageSets: not each frame once", sorted(sets["train"] + sets["val"]) == everything == sets["trainval"])
    check("ImageSets: test", sets["test"] == [])
    oxts, lines = read_oxts(tracking / f"oxts/{sequence:04}.txt")
    times = np.loadtxt(tracking / f"times/{sequence:04}.txt", ndmin=1)
    check("times", times[0] == 0 and np.allclose(times, np.subtract(settings["times_s"], settings["times_s"][0]), atol=1e-6))
    moved = np.diff([p[:3, 3] for p in oxts], axis=0)
    for i in range(1, len(times) - 1):
        speed = np.linalg.norm(moved[i - 1] + moved[i]) / (times[i + 1] - times[i - 1])
        check(f"oxts: speed {i}", abs(np.hypot(*lines[i, 6:8]) - speed) < 0.02 * speed + 1e-3
              and abs(np.hypot(*lines[i, 8:10]) - speed) < 0.02 * speed + 1e-3)
    for index, file in enumerate(sorted((tracking / f"velodyne/{sequence:04}").iterdir())):
        name = f"{first + index:06}"
        points = np.fromfile(folder / f"training/velodyne/{name}.bin", "<f4").reshape(-1, 4)
        check(f"{file}: other points", points.tobytes() == file.read_bytes())
        picture = folder / f"training/image_2/{name}.png"
        columns, rows, *kind = png_size(picture)
        check(f"{picture}: not 8-bit RGB", kind == [8, 2])
        check(f"{picture}: another size", f" {columns} x {rows}," in settings["camera"])
        check(f"{picture}: not linked", picture.samefile(tracking / f"image_02/{sequence:04}/{index:06}.png"))
        depth = folder / f"training/depth_2/{name}.png"
        check(f"{depth}: another size", png_size(depth) == (columns, rows, 16, 0) if has_pictures else not depth.exists())
        lines = (folder / f"training/calib/{name}.txt").read_text().splitlines()
        calib = {key: np.array(text.split(), float) for key, text in (line.split(":") for line in lines)}
        # The loaders use the order of the lines.
        check(f"{name}: keys", list(calib) == ["P0", "P1", "P2", "P3", "R0_rect", "Tr_velo_to_cam", "Tr_imu_to_velo"])
        p2, r0 = calib["P2"].reshape(3, 4), np.vstack([np.c_[calib["R0_rect"].reshape(3, 3), np.zeros(3)], [0, 0, 0, 1]])
        camera_from_velo = r0 @ np.vstack([calib["Tr_velo_to_cam"].reshape(3, 4), [0, 0, 0, 1]])
        check(f"{name}: calibration", np.allclose(camera_from_velo[:3, :3] @ camera_from_velo[:3, :3].T, np.eye(3))
              and np.abs(camera_from_velo[:3, :3] - CAMERA_FROM_VELO).max() < 0.2)
        text = (tracking / f"calib/{sequence:04}.txt").read_text().replace("R_rect", "R0_rect:").replace(
            "Tr_velo_cam", "Tr_velo_to_cam:").replace("Tr_imu_velo", "Tr_imu_to_velo:")
        check(f"{name}: calibration for tracking", text.splitlines() == lines)
        to_pixels = p2 @ camera_from_velo
        if settings["camera"].startswith("kitti "):
            check_kitti_camera(to_pixels)
        if fov == "camera":
            pixels, front = project(to_pixels, points[:, :3].astype(float))
            check(f"{name}: points outside the picture",
                  front.all() and (pixels > -0.01).all() and (pixels < np.add([columns, rows], 0.01)).all())
        boxes = []
        labels = (folder / f"training/label_2/{name}.txt").read_text().splitlines()
        check(f"{name}: no label", labels)
        tracked = [line.split() for line in tracks if line.split()[0] == str(index)]
        nothing = "DontCare -1 -1 -10 0.00 0.00 0.00 0.00 -1 -1 -1 -1000 -1000 -1000 -10"
        check(f"{name}: other tracking labels", [t[2:3] + t[4:] for t in tracked] == [
            line.split()[:1] + line.split()[2:] for line in labels if line != nothing])
        numbers = [t[1] for t in tracked if t[2] != "DontCare"]
        check(f"{name}: a track occurs twice", len(set(numbers)) == len(numbers))
        types = [line.split()[0] for line in labels]
        check(f"{name}: DontCare before objects", "DontCare" not in types[:len(numbers)] and set(types[len(numbers):]) <= {"DontCare"})
        unlabelled = []
        for line in labels:
            words = line.split()
            truncated, occluded, alpha, *numbers = map(float, words[1:])
            box = np.array(numbers[:4])
            check(f"{name}: {line}", len(words) == 15)
            check(f"{name}: outside the picture: {line}", (box >= 0).all() and (box[[0, 2]] <= columns - 1).all() and (box[[1, 3]] <= rows - 1).all())
            if words[0] == "DontCare":
                check(f"{name}: {line}", words[1:4] == ["-1", "-1", "-10"] and numbers[4:] == [-1, -1, -1, -1000, -1000, -1000, -10])
                unlabelled.append(box)
                continue
            height, width, length, x, y, z, turn = numbers[4:]
            check(f"{name}: {line}", 0 <= truncated <= 1 and occluded in (0, 1, 2, 3))
            seen_from = (alpha - turn + np.arctan2(x, z)) / (2 * np.pi)
            check(f"{name}: alpha of {line}", abs(seen_from - round(seen_from)) < 1e-4)
            c, s = np.cos(turn), np.sin(turn)   # turn about the y axis, which points down
            # The forward axis of the box. The LiDAR and the box are upright.
            forward = camera_from_velo[:3, :3].T @ [c, 0, -s]
            yaw = np.arctan2(forward[1], forward[0])
            centre = (np.linalg.inv(camera_from_velo) @ [x, y, z, 1])[:3] + [0, 0, height / 2]
            velo_from_box = pose([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]], centre)
            boxes.append((velo_from_box, (length, width, height), occluded, words[0]))
            corners = corners_of((length, width, height)) @ velo_from_box[:3, :3].T + centre
            if (corners @ camera_from_velo[2, :3] + camera_from_velo[2, 3] > 0.2).all():
                expected, share = rectangle(to_pixels, corners, columns, rows)
                is_inside = (expected[:2] < expected[2:]).all()
                # A label has no roll and pitch. They turn a box that is not upright by a small angle.
                tolerance_px = 1e-3 * p2[0, 0] + 0.02
                check(f"{name}: {expected} expected: {line}", np.abs(box - (expected if is_inside else 0)).max() < tolerance_px)
                check(f"{name}: truncation {share} expected: {line}", abs(truncated - share) < 0.02)
            check(f"{name}: no rectangle: {line}", fov == "all" or (box[:2] < box[2:]).all())
        frames.append((points[:, :3], boxes, None, (to_pixels, columns, rows, unlabelled, oxts[index])))
    return frames


def check_kitti_camera(to_pixels):
    """Compares with the published calibration of camera 2 of 2011-09-26."""
    p = np.array([[7.215377e+02, 0, 6.095593e+02, 4.485728e+01], [0, 7.215377e+02, 1.728540e+02, 2.163791e-01], [0, 0, 1, 2.745884e-03]])
    r = np.array([[9.999239e-01, 9.837760e-03, -7.445048e-03], [-9.869795e-03, 9.999421e-01, -4.278459e-03], [7.402527e-03, 4.351614e-03, 9.999631e-01]])
    t = np.array([[7.533745e-03, -9.999714e-01, -6.166020e-04, -4.069766e-03], [1.480249e-02, 7.280733e-04, -9.998902e-01, -7.631618e-02],
                  [9.998621e-01, 7.523790e-03, 1.480755e-02, -2.717806e-01]])
    points = np.array([[5, 1, -1], [20, -8, 0.5], [60, 30, -1.5]], float)
    expected, _ = project(p @ np.vstack([r @ t, [0, 0, 0, 1]]), points)
    check("kitti: another calibration", np.abs(project(to_pixels, points)[0] - expected).max() < 0.01)


def check_picture(frame, world_from_rig, all_boxes, first_rig):
    """Compares occlusion, DontCare and the pose of a frame of kitti with the expected boxes."""
    _, boxes, _, (to_pixels, columns, rows, unlabelled, moved) = frame
    rig_from_world = np.linalg.inv(world_from_rig)
    check("oxts: another pose", np.abs(np.linalg.inv(first_rig) @ world_from_rig - moved).max() < 1e-3)
    for world_from_box, size, n_points, share in all_boxes:
        box = rig_from_world @ world_from_box
        levels = [occluded for m, s, occluded, _ in boxes if np.abs(m - box)[:3, 3].max() < 2e-3]
        check(f"occlusion {levels} of {share}", levels in ([], [0 if share >= 0.8 else 1 if share >= 0.4 else 2]))
        corners = corners_of(size) @ box[:3, :3].T + box[:3, 3]
        if n_points == 0 and project(to_pixels, corners)[1].all():
            expected, _ = rectangle(to_pixels, corners, columns, rows)
            if (expected[2:] > expected[:2]).all():
                check("an object without points is no DontCare", any(np.abs(u - expected).max() < 0.5 for u in unlabelled))


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


def check_camera(folder, channel, data, mount, to_world, world_from_lidar):
    size = png_size(folder / data["filename"])[:2]
    check(f"{channel}: picture of another size", size == (data["width"], data["height"]))
    intrinsic = np.array(mount["camera_intrinsic"])
    centre = intrinsic[:2, 2] / size
    check(f"{channel}: intrinsic", intrinsic.shape == (3, 3) and (np.diag(intrinsic)[:2] > 100).all()
          and (intrinsic[2] == [0, 0, 1]).all() and (centre > 0.3).all() and (centre < 0.7).all())
    axes = world_from_lidar[:3, :3].T @ to_world[:3, :3]   # x right, y down, z forward, in the frame of the LiDAR
    yaw = np.radians({"FRONT": 0, "FRONT_LEFT": 55, "FRONT_RIGHT": -55, "BACK": 180, "BACK_LEFT": 110, "BACK_RIGHT": -110}[channel[4:]])
    check(f"{channel}: axes", axes[:, 2] @ [np.cos(yaw), np.sin(yaw), 0] > 0.98 and axes[2, 1] < -0.98 and np.linalg.det(axes) > 0.99)


def read_scene(folder, table, scene):
    frames, token = [], scene["first_sample_token"]
    while token:
        sample = table["sample"][token]
        check("sample: another scene", sample["scene_token"] == scene["token"])
        points, from_lidar, cameras = [], [], []
        for data in table["sample_data"].values():
            if data["sample_token"] != token:
                continue
            check("sample_data: time", data["is_key_frame"] and data["timestamp"] == sample["timestamp"])
            mount = table["calibrated_sensor"][data["calibrated_sensor_token"]]
            ego = table["ego_pose"][data["ego_pose_token"]]
            channel = table["sensor"][mount["sensor_token"]]["channel"]
            to_world = pose(rotation(*ego["rotation"]), ego["translation"]) @ pose(
                rotation(*mount["rotation"]), mount["translation"])
            if table["sensor"][mount["sensor_token"]]["modality"] == "camera":
                cameras.append((channel, data, mount, to_world))
                continue
            if channel == "LIDAR_TOP":   # x right, y forward
                world_from_lidar = to_world @ pose(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], float), [0, 0, 0])
            cloud = np.fromfile(folder / data["filename"], "<f4").reshape(-1, 5)
            slope = cloud[:, 2] / np.hypot(cloud[:, 0], cloud[:, 1])
            of_rings = [np.median(slope[cloud[:, 4] == ring]) for ring in np.unique(cloud[:, 4])]
            check("rings: not from the lowest to the highest", (np.diff(of_rings) > 0).all())
            points.append(cloud[:, :3] @ to_world[:3, :3].T + to_world[:3, 3])
            from_lidar.append(channel)
        check(f"channels {from_lidar}", len(set(from_lidar)) == len(from_lidar) and "LIDAR_TOP" in from_lidar)
        check(f"cameras {[c[0] for c in cameras]}", sorted(c[0] for c in cameras) == CAMERAS)
        for camera in cameras:
            check_camera(folder, *camera, world_from_lidar)
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
    """Returns the poses of the rig, and the boxes of each frame in the world: pose, size, number of points, and
    visible share. The pose is of the sensor with the most points."""
    sensors = json.loads(pathlib.Path(rig).read_text())["sensors"]
    scans = [json.loads((folder / s["name"] / "scans.json").read_text())["scans"] for s in sensors]
    frames = []
    for entries in zip(*scans):
        best, share = {}, {}
        for entry in entries:
            for box in entry["boxes"]:
                track = box["track"]
                share[track] = max(share.get(track, 0), box["visible_share"])
                if not box.get("note") and box["points"] >= best.get(track, {"points": 0})["points"]:
                    best[track] = box
        world_from_rig = np.array(entries[0]["world_from_sensor"]) @ pose(
            np.eye(3), -np.array(sensors[0].get("translation_m", [0, 0, 0]), float))   # the first sensor is not turned
        frames.append((world_from_rig, [(np.array(b["world_from_box"]), b["size_m"], b["points"], share[t]) for t, b in best.items()]))
    return frames


def main():
    layout, folder, sequence, *truth = sys.argv[1:]
    frames = READERS[layout](pathlib.Path(folder), int(sequence))
    n_boxes = sum(len(frame[1]) for frame in frames)
    print(f"{layout}: {len(frames)} frames, {n_boxes} boxes")
    empty = sum(count_inside(points, m, np.add(size, 1.0)) == 0 for points, boxes, *_ in frames for m, size, *_ in boxes)
    check(f"{empty} boxes without points", empty == 0)
    if truth:
        n_expected = n_found = n_near = 0
        expected_frames = read_truth(pathlib.Path(truth[0]), truth[1])
        for frame, (world_from_rig, all_boxes) in zip(frames, expected_frames):
            _, boxes, world_from_lidar, *_ = frame
            if layout == "kitti":
                check_picture(frame, world_from_rig, all_boxes, expected_frames[0][0])
            expected = [(m, size) for m, size, n_points, _ in all_boxes if n_points > 0]
            is_local = world_from_lidar is None
            to_frame = np.linalg.inv(world_from_rig) if is_local else np.eye(4)
            centre = np.zeros(3) if is_local else world_from_rig[:3, 3]
            near = [(m, s) for m, s, *_ in boxes if np.linalg.norm(m[:3, 3] - centre) < MAX_RANGE_M]
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
