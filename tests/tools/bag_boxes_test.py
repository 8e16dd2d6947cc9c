# SPDX-License-Identifier: Apache-2.0
"""Tests boxes in ROS bags. bag_writer.py writes the bags from the definitions of vision_msgs and of
Autoware. A car drives a bend through a round hall with a moving and a parked object. Boxes are
stored in the frame of the map, of the vehicle or of a camera. relidar must convert them to the map.

   bag_boxes_test.py RELIDAR WORK        77: numpy is missing
"""
import json
import uuid

from bag_harness import WORK, cloud, convert, expect, header, np, pose, run, run_tests, transform, turned

import bag_writer as bags
from names import names

T0, STEP, N, ROWS, COLUMNS = 1_700_000_000_250_000_000, 100_000_000, 5, 8, 180
IDS = [uuid.UUID(int=0x1234_5678_0000_4000_8000_0000_0000_0001), uuid.UUID(int=0x1234_5678_0000_4000_8000_0000_0000_0002)]
SIZES = [(4.5, 1.9, 1.6), (0.6, 0.7, 1.8)]
CAMERA = (np.array([1.5, 0.2, 1.4]), 0.7)   # pose in base_link: position and yaw

EMPTY_CLOUD = {"height": 0, "width": 0, "fields": [], "is_bigendian": 0, "point_step": 0, "row_step": 0, "data": b"", "is_dense": 1}
COVARIED = [("pose", bags.POSE), bags.COVARIANCE]
BOX = [("center", bags.POSE), ("size", bags.POSE[0][1])]
SPEED = [("twist", bags.TWIST), bags.COVARIANCE]
POLYGON = [[("x", "f"), ("y", "f"), ("z", "f")]]
SHAPE = [("type", "B"), ("footprint", POLYGON), ("dimensions", bags.POSE[0][1])]


def detections(results, *rest):
    return [("header", bags.HEADER), ("detections", [[("header", bags.HEADER), ("results", [results]), ("bbox", BOX), *rest]])]


def objects(*kinematics):
    of_one = [("object_id", ("B", 16)), ("existence_probability", "f"), ("classification", [[("label", "B"), ("probability", "f")]]),
              ("kinematics", list(kinematics)), ("shape", SHAPE)]
    return [("header", bags.HEADER), ("objects", [of_one])]


CLOUD = ("source_cloud", bags.TYPES["sensor_msgs/PointCloud2"])
NESTED = [("hypothesis", [("class_id", "string"), ("score", "d")]), ("pose", COVARIED)]
NAMED, NUMBERED = ([("id", kind), ("score", "d"), ("pose", COVARIED)] for kind in ("string", "q"))
TRACKED, KNOWN, STANDS = ("tracking_id", "string"), ("orientation_availability", "B"), ("is_stationary", "B")
POSED, MOVING, PUSHED = ("pose_with_covariance", COVARIED), ("twist_with_covariance", SPEED), ("acceleration_with_covariance", SPEED)
VERSIONS = {   # message type, definition, format, whether objects have an id
    "vision_msgs 4": ("vision_msgs/Detection3DArray", detections(NESTED, ("id", "string")), "cdr", True),
    "vision_msgs 2": ("vision_msgs/Detection3DArray", detections(NAMED, CLOUD, ("is_tracking", "B"), TRACKED), "cdr_be", True),
    "vision_msgs 1": ("vision_msgs/Detection3DArray", detections(NAMED, CLOUD), "cdr", False),
    "vision_msgs of ROS 1": ("vision_msgs/Detection3DArray", detections(NUMBERED, CLOUD), "ros1", False),
    "vision_msgs of ROS 1, tracked": ("vision_msgs/Detection3DArray", detections(NUMBERED, CLOUD, ("is_tracking", "B"), TRACKED), "ros1", True),
    "Autoware": ("autoware_perception_msgs/TrackedObjects", objects(POSED, MOVING, PUSHED, KNOWN, STANDS), "cdr", True),
    "Autoware.Auto": ("autoware_auto_perception_msgs/TrackedObjects", objects(POSED, KNOWN, MOVING, PUSHED, STANDS), "cdr", True),
}


def car(t):
    """Returns the pose of base_link in the map at a time in seconds after T0."""
    return np.array([3 + 8 * t, 2 + t, 0]), 0.2 + 0.3 * t


def thing(number, t):
    return ((np.array([12 - 3 * t, 4 + 2 * t * t, 0.8]), 2.5 + 0.5 * t), (np.array([-4, 6, 0.9]), 1.0))[number]


def seen_from(frame, t, placed):
    place, yaw = placed
    if frame == "map":
        return placed
    origin, heading = car(t)
    place, yaw = turned(place - origin, -heading), yaw - heading
    return (place, yaw) if frame == "base_link" else (turned(place - CAMERA[0], -CAMERA[1]), yaw - CAMERA[1])


def box_list(type_name, frame, ns, number_of=lambda k: k, named=True):
    """Returns the boxes of both objects at a time. The class of the first object is not certain."""
    t, stamp = 1e-9 * ns, T0 + ns
    values = []
    for k in (0, 1):
        placed, size = pose(*seen_from(frame, t, thing(k, t))), dict(zip("xyz", SIZES[k]))
        covaried, covariance = {"pose": placed, "covariance": [0.5] * 36}, [0.0] * 36
        twist = {"twist": {"linear": dict(x=1.0, y=0.0, z=0.0), "angular": dict(x=0.0, y=0.0, z=0.0)}, "covariance": covariance}
        identity = IDS[k] if named else uuid.UUID(int=0)
        if "vision" in type_name:
            classes = [(2, 0.2), (1, 0.8)] if k == 0 else [(7, 1.0)]
            results = [{"hypothesis": {"class_id": f"class {n}", "score": s}, "id": number_of(n), "score": s, "pose": covaried} for n, s in classes]
            values.append({"header": header(stamp, frame), "results": results, "bbox": {"center": placed, "size": size},
                           "source_cloud": {"header": header(0, ""), **EMPTY_CLOUD}, "is_tracking": 1, "id": str(identity) if named else "",
                           "tracking_id": str(identity) if named else ""})
        else:
            classes = [(2, 0.2), (1, 0.8)] if k == 0 else [(7, 1.0)]
            outline = [dict(x=x * SIZES[k][0] - 0.1, y=y * SIZES[k][1], z=0.0) for x, y in ((-.5, -.5), (.5, -.5), (.5, .5), (-.5, .5))]
            polygon = k == 1   # the pose of the polygon is 0.1 m before its middle
            if polygon:
                middle, yaw = seen_from(frame, t, thing(k, t))
                placed = pose(middle + turned([0.1, 0, 0], yaw), yaw)
                size = dict(x=0.0, y=0.0, z=SIZES[k][2])
            values.append({"object_id": list(identity.bytes), "existence_probability": 0.9,
                           "classification": [{"label": n, "probability": s} for n, s in classes],
                           "kinematics": {"pose_with_covariance": {"pose": placed, "covariance": covariance}, "twist_with_covariance": twist,
                                          "acceleration_with_covariance": twist, "orientation_availability": 2, "is_stationary": 0},
                           "shape": {"type": 2 if polygon else 0, "footprint": outline if polygon else [], "dimensions": size}})
    return {"header": header(stamp, frame), "detections": values, "objects": values}


def sweep(k):
    azimuth = np.pi - 2 * np.pi * np.arange(COLUMNS) / COLUMNS
    elevation = np.radians(np.linspace(10, -25, ROWS))[:, None]
    points = np.zeros((ROWS, COLUMNS), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4"), ("ring", "<u2")])
    points["x"], points["y"] = 20 * np.cos(elevation) * np.cos(azimuth), 20 * np.cos(elevation) * np.sin(azimuth)
    points["z"], points["intensity"] = 20 * np.sin(elevation), 30
    points["t"], points["ring"] = np.arange(COLUMNS) * (STEP // COLUMNS), np.arange(ROWS)[:, None]
    return cloud(T0 + k * STEP, "lidar", points)


def log(extra=(), with_poses=True):
    out = [("/tf_static", "tf2_msgs/TFMessage", T0 - STEP, {"transforms": [transform(0, "base_link", "lidar", [0.8, 0, 1.7], np.pi / 2),
                                                                            transform(0, "base_link", "camera", *CAMERA)]})]
    for ns in range(-STEP, (N + 2) * STEP, 10_000_000) if with_poses else ():
        out.append(("/tf", "tf2_msgs/TFMessage", T0 + ns, {"transforms": [transform(T0 + ns, "map", "base_link", *car(1e-9 * ns))]}))
    out += [("/points", "sensor_msgs/PointCloud2", T0 + k * STEP + 9_000_000, sweep(k)) for k in range(N)]
    return sorted(out + list(extra), key=lambda m: m[2])


def boxes_in(topic, version, frame, rate_hz=20, **given):
    type_name, definition, _, has_identity = VERSIONS[version]
    bags.TYPES[type_name] = definition
    numbered = "ROS 1" in version
    given = {"number_of": (lambda n: n) if numbered else (lambda n: f"class {n}"), **given}
    return [(topic, type_name, T0 + ns + 3_000_000, box_list(type_name, frame, ns, **given)) for ns in range(0, N * STEP, 10**9 // rate_hz)]


def converted(bag, *settings):
    folder, _, notes = convert(bag, *settings)
    file = folder / "boxes.json"
    return json.loads(file.read_text())["boxes"] if file.exists() else [], notes


def check(name, boxes, n=10, ids=IDS, categories=("class 1", "class 7")):
    expect(len(boxes) == 2 * n, f"{name}: {len(boxes)} boxes, expected {2 * n}")
    for box in boxes:
        k = [str(i) for i in ids].index(box["track"])
        place, yaw = thing(k, box["time_s"])
        expect(abs(box["time_s"] / (0.5 / n) - round(box["time_s"] / (0.5 / n))) < 1e-6, f"{name}: a box at {box['time_s']} s")
        expect(np.abs(np.array(box["position"]) - place).max() < 1e-6, f"{name}: {box} at {place}")
        expect(abs(abs(np.dot(box["quaternion"], [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])) - 1) < 1e-9, f"{name}: {box} turned by {yaw}")
        expect(np.abs(np.array(box["size"]) - SIZES[k]).max() < 1e-6, f"{name}: sizes {box['size']}")
        expect(box["category"] == categories[k], f"{name}: category {box['category']}, expected {categories[k]}")


def test_versions():
    for name, (type_name, _, form, has_identity) in VERSIONS.items():
        for frame in ("map", "base_link", "camera") if form == "cdr" else ("camera",):
            bag = WORK / ("boxes.bag" if form == "ros1" else "boxes.mcap")
            messages = log(boxes_in("/things", name, frame))
            bags.write_ros1(bag, messages) if form == "ros1" else bags.write_mcap(bag, messages, form=form)
            boxes, notes = converted(bag)
            expect("20 boxes" in notes, f"{name}: {notes}")
            if not has_identity:
                expect(boxes == [] and names(notes, "20 boxes ... track"), f"{name}: {notes}")
            else:
                check(f"{name}, in {frame}", boxes, categories=("class 1", "class 7") if "vision" in type_name else ("car", "pedestrian"))


def test_choice():
    nameless = [("/found", "autoware_perception_msgs/DetectedObjects", T0, {"data": "not looked at"})]
    bags.TYPES["autoware_perception_msgs/DetectedObjects"] = bags.TYPES["std_msgs/String"]
    few, many = boxes_in("/few", "vision_msgs 4", "map", 10), boxes_in("/many", "Autoware", "map", 20)
    bag = WORK / "choice.mcap"
    bags.write_mcap(bag, log(few + many + nameless))
    boxes, notes = converted(bag)
    check("the topic with more boxes", boxes, categories=("car", "pedestrian"))
    for text in ("read from /many", "/few ... ignored: 10", "/found ... ignored", "topic /many: autoware_perception_msgs/TrackedObjects"):
        expect(names(notes, text), f"no '{text}' in {notes}")
    expect(names(notes, "20 ... : used") and names(notes, "10 ... track id\n"), f"what is used: {notes}")
    expect("boxes       2: 1 moving, 1 parked" in run("info", bag), "info does not count the boxes")
    bags.write_mcap(bag, log(boxes_in("/things", "vision_msgs 4", "map", named=False) + many))
    boxes, notes = converted(bag)
    check("detections without an identity beside tracks", boxes, categories=("car", "pedestrian"))
    expect(names(notes, "/things ... ignored ... 20"), notes)


def test_clocks():
    """The LiDAR has TAI, 37 s ahead of the clock of poses and boxes."""
    for frame in ("map", "camera"):
        bag = WORK / "clocks.mcap"
        bags.write_mcap(bag, [(*m[:3], dict(m[3], header=header(m[3]["header"]["stamp"] + 37 * 10**9, "lidar"))) if m[0] == "/points" else m
                              for m in log(boxes_in("/things", "vision_msgs 4", frame))])
        check(f"another clock, in {frame}", converted(bag)[0])


def test_places():
    bag = WORK / "places.mcap"
    bags.write_mcap(bag, log(boxes_in("/things", "vision_msgs 4", "radar")))
    boxes, notes = converted(bag)
    expect(boxes == [] and names(notes, "pose ... 'radar'"), f"a frame that nobody knows: {notes}")
    bags.write_mcap(bag, log(boxes_in("/things", "vision_msgs 4", "camera"), with_poses=False))
    boxes, notes = converted(bag)
    for box in boxes:   # if a log has no poses, its world is the frame of the LiDAR
        k = [str(i) for i in IDS].index(box["track"])
        place, yaw = seen_from("base_link", box["time_s"], thing(k, box["time_s"]))
        place = turned(place - np.array([0.8, 0, 1.7]), -np.pi / 2)
        expect(np.abs(np.array(box["position"]) - place).max() < 1e-6, f"without poses: {box} at {place}")
    expect(len(boxes) == 20, f"without poses: {len(boxes)} boxes\n{notes}")
    bags.write_mcap(bag, log(2 * boxes_in("/things", "vision_msgs 4", "camera")))
    boxes, notes = converted(bag, "--frames", "1:3")
    expect({round(b["time_s"], 6) for b in boxes} == {0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3} and len(boxes) == 14, f"boxes of two frames: {boxes}")
    expect(names(notes, "14 boxes ... track"), notes)


run_tests(test_versions, test_choice, test_clocks, test_places)
