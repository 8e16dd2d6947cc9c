# SPDX-License-Identifier: Apache-2.0
"""Tests the live connection of Foxglove to `relidar view` with a WebSocket client of the standard
library. Decodes the messages with the schemas that the server advertises, and compares the points
with the files of `relidar render`.

    foxglove_test.py RELIDAR WORK_FOLDER

Exits with 77 (skipped) if python3-protobuf or numpy is missing."""
import base64
import json
import os
import pathlib
import socket
import struct
import subprocess
import sys
import time
import urllib.parse

try:
    import numpy as np
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
except ImportError as error:
    print(f"skipped: {error} (tools/dev/setup --tests)")
    sys.exit(77)

from viewer_process import PATIENCE_S, Viewer, train_street

PROTOCOL = "foxglove.websocket.v1"
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
INTERVAL_S = 0.1   # between the frames of the street


class Client:
    """A WebSocket client, RFC 6455."""

    def __init__(self, url, protocols=PROTOCOL, origin=None):
        address = urllib.parse.urlsplit(url)
        self.socket = socket.create_connection((address.hostname, address.port), timeout=PATIENCE_S)
        self.received = b""
        fields = ["GET / HTTP/1.1", f"Host: {address.netloc}", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
                  f"Sec-WebSocket-Key: {base64.b64encode(bytes(16)).decode()}", f"Sec-WebSocket-Protocol: {protocols}"]
        fields += [f"Origin: {origin}"] if origin else []
        self.socket.sendall("\r\n".join(fields + ["", ""]).encode())
        header = b""
        while not header.endswith(b"\r\n\r\n"):
            header += self.read(1)
        self.header = header.decode().lower().split("\r\n")

    def read(self, n_bytes):
        while len(self.received) < n_bytes:
            part = self.socket.recv(1 << 16)
            if not part:
                raise ConnectionError("the server has closed the connection")
            self.received += part
        result, self.received = self.received[:n_bytes], self.received[n_bytes:]
        return result

    def send(self, payload, opcode=TEXT):
        n = len(payload)
        length = bytes([0x80 | n]) if n < 126 else struct.pack(">BH", 0xFE, n) if n < 65536 else struct.pack(">BQ", 0xFF, n)
        self.socket.sendall(bytes([0x80 | opcode]) + length + bytes(4) + payload)   # the mask is 0

    def request(self, operation, **fields):
        self.send(json.dumps({"op": operation, **fields}).encode())

    def receive(self):
        """Returns the opcode and the payload of the next frame. Answers pings."""
        while True:
            first, length = self.read(2)
            if length > 125:
                length = int.from_bytes(self.read(2 if length == 126 else 8), "big")
            opcode, payload = first & 15, self.read(length)
            if opcode != PING:
                return opcode, payload
            self.send(payload, PONG)

    def receive_json(self):
        """Returns the next text. Skips binary messages."""
        while True:
            opcode, payload = self.receive()
            assert opcode in (TEXT, BINARY), opcode
            if opcode == TEXT:
                return json.loads(payload)

    def receive_binary(self):
        """Returns the next time of the server, or the subscription, log time and bytes of a message."""
        opcode, payload = self.receive()
        assert opcode == BINARY, (opcode, payload)
        if payload[0] == 2:
            return struct.unpack("<Q", payload[1:])[0]
        assert payload[0] == 1, payload[0]
        return *struct.unpack_from("<IQ", payload, 1), payload[13:]

    def is_silent(self, seconds):
        """Returns true if no frame arrives within this time."""
        self.socket.settimeout(seconds)
        try:
            self.receive()
            return False
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(PATIENCE_S)


class Topics:
    """The topics that a server advertises. Decodes their messages."""

    def __init__(self, client):
        self.info, advertisement = client.receive_json(), client.receive_json()
        assert self.info["op"] == "serverInfo" and advertisement["op"] == "advertise", (self.info, advertisement)
        self.by_name = {channel["topic"]: channel for channel in advertisement["channels"]}

    def id(self, topic):
        return self.by_name[topic]["id"]

    def decode(self, topic, payload):
        channel, pool = self.by_name[topic], descriptor_pool.DescriptorPool()
        assert channel["encoding"] == "protobuf", channel["encoding"]
        for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"], validate=True)).file:
            pool.Add(file)
        descriptor = pool.FindMessageTypeByName(channel["schemaName"])
        if hasattr(message_factory, "GetMessageClass"):
            return message_factory.GetMessageClass(descriptor).FromString(payload)
        return message_factory.MessageFactory(pool).GetPrototype(descriptor).FromString(payload)


def read_cloud(cloud):
    """Returns the points of a foxglove.PointCloud as a structured array."""
    kinds = {1: "<u1", 3: "<u2", 6: "<i4", 7: "<f4"}
    fields = {"names": [f.name for f in cloud.fields], "formats": [kinds[f.type] for f in cloud.fields],
              "offsets": [f.offset for f in cloud.fields], "itemsize": cloud.point_stride}
    return np.frombuffer(cloud.data, np.dtype(fields))


def read_ply(path):
    header, _, body = path.read_bytes().partition(b"end_header\n")
    kinds = {"float": "<f4", "int": "<i4", "uint16": "<u2", "ushort": "<u2", "uint8": "<u1", "uchar": "<u1"}
    return np.frombuffer(body, [(line.split()[2], kinds[line.split()[1]]) for line in header.decode().splitlines() if line.startswith("property")])


def render_files(relidar, work):
    """Returns the points of each frame by the time of its first ray in nanoseconds."""
    subprocess.run([relidar, "render", "run", "--out", "files", "--format", "ply,npz", "--frames", "all", "--quiet"], cwd=work, check=True)
    summary = json.loads((work / "files/scans.json").read_text())
    clouds = {}
    for scan in summary["scans"]:
        ply, npz = (work / "files" / name for name in sorted(scan["files"], reverse=True))
        clouds[scan["time_s"] + float(np.load(npz)["time"].min())] = read_ply(ply)
    shift_s = np.ceil(-min(clouds))   # times of recordings begin at 0 or later
    return {round((first_s + shift_s) * 1e9): cloud for first_s, cloud in clouds.items()}


def check_hello(client, protocol):
    assert "101" in client.header[0] and f"sec-websocket-protocol: {protocol}" in client.header, client.header
    topics = Topics(client)
    assert topics.info["capabilities"] == ["time"], topics.info
    assert {name: channel["schemaName"] for name, channel in topics.by_name.items()} == {
        "/lidar/points": "foxglove.PointCloud", "/tf": "foxglove.FrameTransforms", "/tf_static": "foxglove.FrameTransforms",
        "/actors": "foxglove.SceneUpdate"}, topics.by_name.keys()
    return topics


def check_cloud(cloud, files):
    stamp_ns = cloud.timestamp.seconds * 10**9 + cloud.timestamp.nanos
    file_ns = min(files, key=lambda t: abs(t - stamp_ns))
    assert abs(file_ns - stamp_ns) < 1000, (stamp_ns, sorted(files))
    points, expected = read_cloud(cloud), files[file_ns]
    assert len(points) == len(expected) > 1000, (len(points), len(expected))
    for name in ("x", "y", "z", "intensity"):
        np.testing.assert_allclose(points[name], expected[name], rtol=1e-4, atol=1e-4, err_msg=name)
    for name in ("ring", "instance"):
        np.testing.assert_array_equal(points[name], expected[name], err_msg=name)
    return file_ns


def check_loop(client, topics, files):
    """Receives points and poses for more than one loop over the log."""
    n_clouds, served, times_ns, n_poses, begin = 0, [], [], 0, time.monotonic()
    while n_clouds < len(files) + 2:
        message = client.receive_binary()
        if isinstance(message, int):
            times_ns.append(message)
            continue
        subscription, logged_ns, payload = message
        assert logged_ns <= times_ns[-1], "the time of the server precedes its messages"
        if subscription == 8:
            transform, = topics.decode("/tf", payload).transforms
            assert (transform.parent_frame_id, transform.child_frame_id) == ("world", "base_link"), transform
            n_poses += 1
            continue
        assert subscription == 7, subscription
        served.append(check_cloud(topics.decode("/lidar/points", payload), files))
        n_clouds += 1
    order = sorted(files)
    assert served == order + order[:2], (served, order)
    n_decreases = sum(later < earlier for earlier, later in zip(times_ns, times_ns[1:]))
    assert n_decreases == 1, times_ns   # at the beginning of the second loop
    assert n_poses > 5 * n_clouds, n_poses
    took_s = time.monotonic() - begin
    assert took_s > 0.9 * INTERVAL_S * (n_clouds - 1), f"{n_clouds} scans in {took_s} s"
    print(f"{n_clouds} scans in {took_s:.2f} s")


def check_actors(client, topics, run):
    boxes = {box["id"] for box in json.loads((run / "scene.json").read_text())["boxes"]}
    message = client.receive_binary()
    while isinstance(message, int):
        message = client.receive_binary()
    assert message[0] == 0, message[0]
    update = topics.decode("/actors", message[2])
    assert {entity.id for entity in update.entities} == boxes and all(len(e.cubes) == 1 for e in update.entities), update


def check_bad_messages(url):
    """Checks that each bad message is answered by an error, and that a binary message ends the connection."""
    client = Client(url)
    topics = Topics(client)
    client.request("subscribe", subscriptions=[{"id": 1, "channelId": topics.id("/tf_static")}])
    bad = ["{", "[]", "\"subscribe\"", "{}", '{"op": 5}', '{"op": "fly"}', '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [3]}',
           '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 0}]}', '{"op": "subscribe", "subscriptions": [{"id": 5, "channelId": 99}]}',
           '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": %d}]}' % topics.id("/tf"),
           '{"op": "subscribe", "subscriptions": [{"id": 2, "channelId": %d}]}' % topics.id("/tf_static"),
           '{"op": "unsubscribe", "subscriptionIds": ["1"]}', '{"op": ' + "[" * 100_000 + "]" * 100_000 + "}", "[" * 500_000]
    for text in bad:
        client.send(text.encode())
        status = client.receive_json()
        assert status["op"] == "status" and status["level"] == 2 and status["message"], (text[:60], status)
    client.send(b"\1\0\0\0\0", BINARY)
    while (frame := client.receive())[0] != CLOSE:
        pass
    assert frame[1][:2] == struct.pack(">H", 1003), frame


def cpu_time_s(process):
    fields = pathlib.Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def check_idle(viewer, clients):
    """Checks that nothing is sent or rendered without subscriptions."""
    before_s = cpu_time_s(viewer.process)
    assert all(client.is_silent(0.5) for client in clients)
    used_s = cpu_time_s(viewer.process) - before_s
    assert used_s < 0.2, f"{used_s} s of processor time without subscriptions"


def unsubscribe(client, *ids):
    client.request("unsubscribe", subscriptionIds=list(ids))
    while not client.is_silent(1.0):   # the scan that is being rendered
        pass


def check(viewer, relidar, work):
    files = render_files(relidar, work)
    first = Client(viewer.url)
    topics = check_hello(first, PROTOCOL)
    second = Client(viewer.url, "unknown, foxglove.sdk.v1, " + PROTOCOL, "https://app.foxglove.dev")
    check_hello(second, "foxglove.sdk.v1")
    check_idle(viewer, [first, second])
    first.request("subscribe", subscriptions=[{"id": 7, "channelId": topics.id("/lidar/points")}, {"id": 8, "channelId": topics.id("/tf")}])
    check_loop(first, topics, files)
    second.request("subscribe", subscriptions=[{"id": 0, "channelId": topics.id("/actors")}])
    check_actors(second, topics, work / "run")
    check_bad_messages(viewer.url)
    assert "403" in Client(viewer.url, origin="http://evil.example").header[0]
    unsubscribe(first, 7, 8)
    check_actors(second, topics, work / "run")   # the other client still receives scans
    unsubscribe(second, 0)
    check_idle(viewer, [first, second])
    first.request("subscribe", subscriptions=[{"id": 7, "channelId": topics.id("/lidar/points")}])
    assert isinstance(first.receive_binary(), int)


def main():
    relidar, work = str(pathlib.Path(sys.argv[1]).resolve()), pathlib.Path(sys.argv[2]).resolve()
    train_street(relidar, work)
    viewer = Viewer(relidar, work, "run", "--port", "0")
    try:
        check(viewer, relidar, work)
        viewer.end()
    finally:
        viewer.kill()
    print("Foxglove receives the scans of the log")


main()
