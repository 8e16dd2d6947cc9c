# SPDX-License-Identifier: Apache-2.0
"""Writes ROS recordings from their specifications (mcap.dev/spec, rosbag2's tables,
wiki.ros.org/Bags/Format/2.0, CDR of the OMG), for tests. It uses no code of relidar. A message is
(topic, type, time in ns, value). Values are nested dicts with the fields of the message
definitions."""
import bz2
import itertools
import sqlite3
import struct
import subprocess
import zlib

HEADER = [("stamp", "time"), ("frame_id", "string")]
POSE = [("position", [("x", "d"), ("y", "d"), ("z", "d")]), ("orientation", [("x", "d"), ("y", "d"), ("z", "d"), ("w", "d")])]
TRANSFORM = [("header", HEADER), ("child_frame_id", "string"), ("transform", POSE)]
COVARIANCE = ("covariance", ("d", 36))
TWIST = [("linear", POSE[0][1]), ("angular", POSE[0][1])]
FIELD = [("name", "string"), ("offset", "I"), ("datatype", "B"), ("count", "I")]
LIVOX = [("offset_time", "I"), ("x", "f"), ("y", "f"), ("z", "f"), ("reflectivity", "B"), ("tag", "B"), ("line", "B")]
PACKET = [("stamp", "time"), ("data", ("B", 1206))]
TYPES = {
    "sensor_msgs/PointCloud2": [("header", HEADER), ("height", "I"), ("width", "I"), ("fields", [FIELD]), ("is_bigendian", "B"),
                                ("point_step", "I"), ("row_step", "I"), ("data", "bytes"), ("is_dense", "B")],
    "tf2_msgs/TFMessage": [("transforms", [TRANSFORM])],
    "nav_msgs/Odometry": [("header", HEADER), ("child_frame_id", "string"), ("pose", [("pose", POSE), COVARIANCE]),
                          ("twist", [("twist", TWIST), COVARIANCE])],
    "geometry_msgs/PoseStamped": [("header", HEADER), ("pose", POSE)],
    "nav_msgs/Path": [("header", HEADER), ("poses", [[("header", HEADER), ("pose", POSE)]])],
    "sensor_msgs/CompressedImage": [("header", HEADER), ("format", "string"), ("data", "bytes")],
    "livox_ros_driver2/CustomMsg": [("header", HEADER), ("timebase", "Q"), ("point_num", "I"), ("lidar_id", "B"), ("rsvd", ("B", 3)),
                                    ("points", [LIVOX])],
    "velodyne_msgs/VelodyneScan": [("header", HEADER), ("packets", [PACKET])],
    "std_msgs/String": [("data", "string")],
}
TYPES["tf/tfMessage"] = TYPES["tf2_msgs/TFMessage"]


class Serial:
    """Serializes values as CDR in either byte order, or in the format of ROS 1."""

    def __init__(self, form):
        self.form, self.out = form, bytearray()
        self.order = ">" if form == "cdr_be" else "<"

    def number(self, code, value):
        size = struct.calcsize(code)
        if self.form != "ros1":
            self.out += bytes(-len(self.out) % size)
        self.out += struct.pack(self.order + code, value)

    def put(self, kind, value, name=""):
        if kind == "string":
            text = value.encode() + (b"" if self.form == "ros1" else b"\0")
            self.number("I", len(text))
            self.out += text
        elif kind == "bytes":
            self.number("I", len(value))
            self.out += value
        elif kind == "time":
            self.number("I", value // 10**9)
            self.number("I", value % 10**9)
        elif isinstance(kind, str):
            self.number(kind, value)
        elif isinstance(kind, tuple) and kind[0] == "B":
            self.out += bytes(value)
        elif isinstance(kind, tuple):       # a list of fixed length
            for item in value:
                self.number(kind[0], item)
        elif isinstance(kind[0], list):     # a list of any length
            self.number("I", len(value))
            for item in value:
                self.put(kind[0], item)
        else:
            if kind is HEADER and self.form == "ros1":
                self.number("I", 7)         # seq
            for field, of in kind:
                self.put(of, value[field], field)


def message_bytes(type_name, value, form):
    serial = Serial(form)
    serial.put(TYPES[type_name], value)
    head = {"cdr": b"\0\1\0\0", "cdr_be": b"\0\0\0\0", "ros1": b""}[form]
    return head + bytes(serial.out)


def packed(compression, data):
    """Compresses bytes with the programs lz4 or zstd, or with bz2 of Python."""
    if compression in ("", "none"):
        return data
    if compression == "bz2":
        return bz2.compress(data)
    return subprocess.run([compression, "-c", "-q"], input=data, capture_output=True, check=True).stdout


def text(value):
    value = value.encode()
    return struct.pack("<I", len(value)) + value


def long_name(type_name):
    return type_name.replace("/", "/msg/")


def batches(records, size):
    """Joins every `size` records."""
    records = iter(records)
    while batch := b"".join(itertools.islice(records, size)):
        yield batch


def write_mcap(path, messages, form="cdr", compression="", chunk=None, end=True, index=False):
    """Writes an MCAP file.
    @param chunk number of messages in a chunk; None: no chunks
    @param end the file ends with a data end and a footer
    @param index also writes the index behind each chunk, and the channels in the summary"""
    encoding = "ros1" if form == "ros1" else "cdr"
    record = lambda code, body: struct.pack("<BQ", code, len(body)) + body
    channels, summary = {}, []

    def index_of(data):
        entries, at = {}, 0
        while at < len(data):
            code, size = struct.unpack_from("<BQ", data, at)
            if code == 5:
                channel, _, log_ns = struct.unpack_from("<HIQ", data, at + 9)
                entries.setdefault(channel, []).append(struct.pack("<QQ", log_ns, at))
            at += 9 + size
        return b"".join(record(7, struct.pack("<HI", c, 16 * len(e)) + b"".join(e)) for c, e in entries.items())

    def records_of(topic, type_name, time_ns, value):
        records = b""
        if topic not in channels:
            number = channels[topic] = len(channels) + 1
            records += record(3, struct.pack("<H", number) + text(long_name(type_name)) + text("ros2msg") + text("string data"))
            records += record(4, struct.pack("<HH", number, number) + text(topic) + text(encoding) + struct.pack("<I", 0))
            summary.append(records)
        return records + record(5, struct.pack("<HIQQ", channels[topic], 0, time_ns, time_ns) + message_bytes(type_name, value, form))

    with open(path, "wb") as out:   # writes messages immediately, because a bag may be larger than memory
        out.write(b"\x89MCAP0\r\n" + record(1, text("ros2") + text("test")))
        for data in batches(itertools.starmap(records_of, messages), chunk or 1):
            body = packed(compression, data)
            out.write(data if chunk is None else record(6, struct.pack("<QQQI", 0, 0, len(data), zlib.crc32(data)) + text(compression) +
                                                        struct.pack("<Q", len(body)) + body))
            if index:
                out.write(index_of(data))
            elif chunk:
                out.write(record(7, struct.pack("<HI", 1, 0)))   # an empty index, which readers must skip
        if end:
            out.write(record(15, struct.pack("<I", 0)))
            start = out.tell() if index else 0
            out.write(b"".join(summary if index else ()) + record(2, struct.pack("<QQI", start, 0, 0)) + b"\x89MCAP0\r\n")


def write_db3(path, messages, form="cdr", compressed=False):
    path.unlink(missing_ok=True)
    base = sqlite3.connect(path)
    base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,serialization_format TEXT NOT NULL,"
                 "offered_qos_profiles TEXT NOT NULL)")
    base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL)")
    topics = {}
    for topic, type_name, time_ns, value in messages:
        if topic not in topics:
            topics[topic] = len(topics) + 1
            base.execute("INSERT INTO topics VALUES (?,?,?,'cdr','')", (topics[topic], topic, long_name(type_name)))
        data = message_bytes(type_name, value, form)
        if compressed:
            data = subprocess.run(["zstd", "-c", "-q", f"--stream-size={len(data)}"], input=data, capture_output=True, check=True).stdout
        base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?,?,?)", (topics[topic], time_ns, data))
    base.commit()
    base.close()


def write_metadata(folder, files, mode=""):
    lines = ["rosbag2_bagfile_information:", "  version: 5", "  storage_identifier: sqlite3", "  relative_file_paths:"]
    lines += [f"    - {name}" for name in files]
    lines += ["  duration:", "    nanoseconds: 1", f'  compression_format: "{"zstd" if mode else ""}"', f'  compression_mode: "{mode}"']
    (folder / "metadata.yaml").write_text("\n".join(lines) + "\n")


def write_ros1(path, messages, compression="none", chunk=5, index=False):
    """Writes a bag. Without index and counts, as `rosbag record` leaves it after an interruption.
    @param index also writes the index behind each chunk, and the connections at the end"""
    def fields(**values):
        return sized(b"".join(sized(name.encode() + b"=" + value) for name, value in values.items()))

    sized = lambda data: struct.pack("<I", len(data)) + data
    connections, listed, entries = {}, [], {}

    def records_of(topic, type_name, time_ns, value):
        records = b""
        if topic not in connections:
            connections[topic] = struct.pack("<I", len(connections))
            about = fields(topic=topic.encode(), type=type_name.encode(), md5sum=b"0" * 32, message_definition=b"string data")
            records += fields(op=b"\7", conn=connections[topic], topic=topic.encode()) + about
            listed.append(records)
        time = struct.pack("<II", time_ns // 10**9, time_ns % 10**9)
        entries.setdefault(connections[topic], []).append(time + struct.pack("<I", 0))   # readers need no offsets
        return records + fields(op=b"\2", conn=connections[topic], time=time) + sized(message_bytes(type_name, value, "ros1"))

    def head(end):
        return b"#ROSBAG V2.0\n" + fields(op=b"\3", index_pos=struct.pack("<Q", end), conn_count=struct.pack("<I", 0),
                                          chunk_count=struct.pack("<I", 0)) + sized(b" " * 4027)

    out = bytearray(head(0))
    for data in batches(itertools.starmap(records_of, messages), chunk):
        out += fields(op=b"\5", compression=compression.encode(), size=struct.pack("<I", len(data))) + sized(packed(compression, data))
        for connection, times in entries.items() if index else ():
            out += fields(op=b"\4", ver=struct.pack("<I", 1), conn=connection, count=struct.pack("<I", len(times))) + sized(b"".join(times))
        entries.clear()
    if index:
        out[:len(head(0))] = head(len(out))
        out += b"".join(listed)
    path.write_bytes(out)
