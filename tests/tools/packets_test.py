# SPDX-License-Identifier: Apache-2.0
"""Tests packets of every product that relidar decodes, written by packet_writer.py for the walls of
a box. Each return must lie on a wall and have its time, ring and reflectivity. Dropped rays must
have no return.

   packets_test.py RELIDAR WORK [pcap]       77: numpy is missing
"""
import gzip
import json
import os
import pathlib
import struct
import sys

from bag_harness import WORK, cloud, convert, expect, header, np, returns, run, run_tests, transform, zero_ns

import bag_writer as bags
import capture_writer as captures
import packet_writer as lidars
from names import names

T0 = 1_700_000_000_250_000_000
bags.TYPES["pandar_msgs/PandarScan"] = [("header", bags.HEADER), ("packets", [[("stamp", "time"), ("data", ("B", 1500)), ("size", "I")]])]
for driver in ("ouster_sensor_msgs", "ouster_msgs", "ouster_ros"):
    bags.TYPES[driver + "/PacketMsg"] = [("buf", "bytes")]
bags.TYPES["nebula_msgs/NebulaPackets"] = [("header", bags.HEADER), ("packets", [[("stamp", "time"), ("data", "bytes")]])]


def messages(packets, type_name, size=30):
    out = []
    for i in range(0, len(packets), size):
        part = [{"stamp": T0 + ns, "data": data.ljust(1500, b"\0") if type_name.startswith("pandar") else data, "size": len(data)}
                for ns, data in packets[i:i + size]]
        out.append(("/packets", type_name, T0 + packets[i][0], {"header": header(T0, "lidar"), "packets": part}))
    return out


def zero_of(head):
    """Returns the seconds from T0 to time 0 of a log."""
    return 1e-9 * (zero_ns(head) - T0)


def returns_of(folder, head, dual):
    """Returns (seconds after T0, direction [3], origin [3], range, intensity, ring, number of the
    return) of the first turn, and the image of this turn."""
    zero_s = zero_of(head)
    scan = np.load(folder / head["frames"][0]["scan"])
    rows = []
    for k in ("", "_2") if dual else ("",):
        hit = scan["range" + k] > 0
        rows.append(np.column_stack([scan["time"][hit].astype(float) + zero_s, scan["directions"][hit], scan["origin"][hit], scan["range" + k][hit],
                                     255 * scan["intensity" + k][hit], scan["ring"][hit], np.full(hit.sum(), k != "")]))
    return np.concatenate(rows), scan, zero_s


def expect_walls(name, points):
    off = np.abs((np.abs(points) / lidars.WALLS).max(1) - 1).max()
    expect(off < 1e-3, f"{name}: {off} of the walls' distance off them")


def check(name, product, folder, head, truth, dual, forward_deg, n_lost=0):
    """@param forward_deg azimuth of the driver's x axis
    @param n_lost number of firings of the turn whose packets were lost"""
    found, scan, zero_s = returns_of(folder, head, dual)
    cycle_s = product.cycle_us * 1e-6
    columns = lidars.TURN_S / cycle_s
    received = columns - n_lost
    expect(scan["range"].shape[0] == product.lasers and received - 1 <= scan["range"].shape[1] <= received + 4, f"{name}: an image of {scan['range'].shape}")
    expect(abs((zero_s / lidars.TURN_S * 360 - forward_deg + 180) % 360 - 180) < 0.02, f"{name}: it faces forward at {zero_s} s")
    ring = np.argsort(np.argsort(-product.elevation, kind="stable"), kind="stable")
    laser = np.argsort(ring)[found[:, 9].astype(int)]
    cycle = np.rint((found[:, 0] - product.offset_us[laser] * 1e-6) / cycle_s).astype(int)
    expect(np.abs(cycle * cycle_s + product.offset_us[laser] * 1e-6 - found[:, 0]).max() < 1.1e-6, f"{name}: times")
    # a turn with fewer firings than columns repeats some firings
    key = np.column_stack([cycle, laser, found[:, 10]]).astype(int)
    key, first = np.unique(key, axis=0, return_index=True)
    found = found[first]
    true_cycle = np.rint((truth[:, 0] - product.offset_us[truth[:, 2].astype(int)] * 1e-6) / cycle_s).astype(int)
    begin = zero_s / cycle_s - columns / 2
    inside = (true_cycle >= begin - 1e-3) & (true_cycle < begin + columns - 1e-3)
    true_key = np.column_stack([true_cycle, truth[:, 2], truth[:, 5]]).astype(int)[inside]
    order = np.lexsort(true_key.T[::-1])
    true_key, truth = true_key[order], truth[inside][order]
    # includes a firing at the very end of the turn
    edge = {int(begin), int(begin) + 1, int(begin + columns), int(begin + columns) - 1}
    inner, true_inner = [~np.isin(k[:, 0], list(edge)) for k in (key, true_key)]
    expect(key[inner].tolist() == true_key[true_inner].tolist(), f"{name}: {inner.sum()} returns, expected {true_inner.sum()}")
    found, truth = found[inner], truth[true_inner]
    expect(len(found) > 0.55 * product.lasers * columns, f"{name}: {len(found)} returns")
    expect(np.abs(found[:, 7] - truth[:, 3]).max() < 1e-5, f"{name}: ranges")
    expect(np.abs(found[:, 8] - truth[:, 4]).max() < 1e-4, f"{name}: reflectivities")
    d = lidars.directions(product, truth[:, 2].astype(int), truth[:, 1])
    apart = np.degrees(np.linalg.norm(found[:, 1:4] - d, axis=1))
    expect(apart.max() < 0.012, f"{name}: directions by up to {apart.max()} degrees")
    strongest = found[:, 10] == 0
    expect_walls(name, found[strongest, 4:7] + found[strongest, 7:8] * found[strongest, 1:4])


def test_bags():
    for product in lidars.PRODUCTS:
        blocks = product.blocks * product.per_block
        forward = 90 if product.hesai else 0
        cases = [(False, 0), (True, 0), (False, "in the middle"), (False, "at the end")]
        for dual, losses in cases if product in (lidars.PRODUCTS[0], lidars.PRODUCTS[5]) else cases[:2]:
            packet_s = product.cycle_us * 1e-6 * blocks / (1 + dual)
            n = int(2.3 * lidars.TURN_S / packet_s)
            # the first full turn begins and ends when the head faces backward
            end_s = ((forward + 180) % 360 / 360 + 1) * lidars.TURN_S
            last = int(end_s / packet_s) - (20 if losses == "in the middle" else 1)
            lost = [last - 1, last] if losses else ()
            name = f"{product.name}, {1 + dual} returns{f', two packets lost {losses}' if losses else ''}"
            packets, truth = lidars.packets(product, n, dual, lost)
            type_name = "pandar_msgs/PandarScan" if product.hesai else "velodyne_msgs/VelodyneScan"
            if lost:
                type_name = "nebula_msgs/NebulaPackets"
            bag = WORK / "packets.mcap"
            bags.write_mcap(bag, messages(packets, type_name), form="ros1" if dual else "cdr")
            folder, head, notes = convert(bag)
            expect(names(notes, "2 packets ... missing") == bool(lost), f"{name}: {notes}")
            expect(product.name in notes, f"{name}: {notes}")
            check(name, product, folder, head, truth, dual, forward, len(lost) * blocks)


def test_alternating():
    """Tests sensors with lasers that fire only in every second block. Each firing must become a
    separate ray, and a silent laser must not add a ray."""
    for product in lidars.ALTERNATING:
        for dual in (False, True) if product.name == "QT128" else (False,):
            name = f"{product.name}, {1 + dual} returns"
            packets, truth = product.packets(int(0.23 / (product.cycle_us * 1e-6 * (1 if dual else 2))), dual)
            bag = WORK / "alternating.mcap"
            bags.write_mcap(bag, messages(packets, "nebula_msgs/NebulaPackets", 100))
            folder, head, notes = convert(bag)
            found, scan, zero_s = returns_of(folder, head, False)
            expect(product.name in notes, f"{name}: {notes}")
            rows, columns = scan["range"].shape
            cycle_s = 2e-6 * product.cycle_us
            expect(rows == (product.offset_us >= 0).sum(), f"{name}: {rows} rows")
            expect(0.1 / cycle_s <= columns <= 0.1 / cycle_s + 4, f"{name}: {columns} columns")
            share = (scan["range"] > 0).mean()
            expect(abs(share - 2 / 3) < 0.003, f"{name}: {share} of the rays return")
            expect_walls(name, found[:, 4:7] + found[:, 7:8] * found[:, 1:4])
            inside = (truth[:, 0] > zero_s - 0.05 + cycle_s) & (truth[:, 0] < zero_s + 0.05 - cycle_s)
            truth = truth[inside]
            elevation = np.degrees(np.arcsin(found[:, 3]))
            # a turn with fewer firings than columns repeats some firings
            times = np.round(found[:, 0] * 1e7)
            inner = (found[:, 0] > zero_s - 0.05 + cycle_s - 1e-8) & (found[:, 0] < zero_s + 0.05 - cycle_s + 1e-8)
            _, first = np.unique(np.column_stack([times, np.round(elevation, 2)])[inner], axis=0, return_index=True)
            expect(abs(len(first) - len(truth)) <= 0.002 * len(truth), f"{name}: {len(first)} returns, expected {len(truth)}")
            near = np.argsort(truth[:, 0], kind="stable")
            wanted = lidars.directions(product, truth[:, 2].astype(int), truth[:, 1] - product.azimuth[truth[:, 2].astype(int)])
            inner &= np.abs(found[:, 0] - zero_s) < 0.05 - 2 * cycle_s
            for k in np.flatnonzero(inner)[::97]:
                low, high = np.searchsorted(truth[near, 0], [found[k, 0] - 2e-6, found[k, 0] + 2e-6])
                apart = np.degrees(np.linalg.norm(wanted[near[low:high]] - found[k, 1:4], axis=1))
                expect(min(apart, default=360) < 0.012, f"{name}: at {found[k, 0]} s its nearest ray is {min(apart, default=360)} degrees apart")


def test_strangers():
    for data, expected in ((b"\xff\xee" + bytes(1203) + b"\x63", "Velarray"), (b"\xee\xff\x04\x03" + bytes(800), "AT128"),
                           (b"\x55\xaa\x05\x0a" + bytes(1244), "rslidar_sdk"), (bytes(700), "700 bytes")):
        bag = WORK / "stranger.mcap"
        bags.write_mcap(bag, messages([(0, data)], "nebula_msgs/NebulaPackets"))
        expect(expected in run("info", bag, code=3), f"packets of another product: {expected}")
    bags.TYPES["robosense_msgs/RobosenseScan"] = bags.TYPES["std_msgs/String"]
    bags.write_mcap(bag, [("/packets", "robosense_msgs/RobosenseScan", T0, {"data": "x"})])
    expect("nebula" in run("info", bag, code=3), "packets that are not decoded")


def test_ousters():
    """Tests the topics of both drivers of Ouster. Each message contains a packet. The metadata is a
    text message before or after the first packet, or a file next to the bag."""
    ouster, tf = lidars.Ouster(), "tf2_msgs/TFMessage"
    packets, metadata = ouster.packets(4), json.dumps(ouster.metadata())
    first = packets[0][0]
    for form, package, when, moves in (("cdr", "ouster_sensor_msgs", -1, False), ("cdr", "ouster_msgs", 10, False), ("ros1", "ouster_ros", -1, True),
                                       ("ros1", "ouster_ros", None, False)):
        name = f"{package} of {form}, metadata {'beside' if when is None else 'late' if when > 0 else 'first'}"
        out = [("/ouster/lidar_packets", package + "/PacketMsg", T0 + ns - first + 200_000 + 90_000 * (k % 3), {"buf": data})
               for k, (ns, data) in enumerate(packets)]
        out += [("/ouster/imu_packets", package + "/PacketMsg", t + 1000, {"buf": bytes(48)}) for _, _, t, _ in out[::4]]
        out += [("/camera/metadata", "std_msgs/String", T0, {"data": "{}"})]
        # moves along x, with the sensor's base 0.3 m behind the base of the vehicle; adds
        # a cloud from the driver
        if moves:
            out += [("/tf_static", tf, T0, {"transforms": [transform(T0, "base_link", "os_sensor", (-0.3, 0, 0)), transform(T0, "os_sensor", "os_lidar", (0, 0, 0), np.pi)]})]
            out += [("/tf", tf, t, {"transforms": [transform(t, "map", "base_link", ((t - T0) * 5e-9, 0, 0))]})
                    for t in range(T0 - 50_000_000, T0 + 600_000_000, 10_000_000)]
            one = cloud(T0, "os_lidar", np.ones(1, [(n, "f4") for n in "xyz"]))
            out += [("/ouster/points", "sensor_msgs/PointCloud2", T0 + k * 100_000_000, one) for k in range(4)]
        if when is not None:
            out += [("/ouster/metadata", "std_msgs/String", T0 + when * 1_000_000, {"data": metadata})]
        out.sort(key=lambda m: m[2])
        bag = WORK / f"ouster_{package}_{when}.{'bag' if form == 'ros1' else 'mcap'}"
        write = bags.write_ros1 if form == "ros1" else bags.write_mcap
        write(bag, out) if form == "ros1" else write(bag, out, form=form)
        if when is None:
            text = run("info", bag, code=3)
            expect(names(text, "3328 bytes ... /ouster/lidar_packets ... metadata"), f"{name}: {text}")
            bag.with_suffix(".json").write_text(metadata)
        folder, head, notes = convert(bag)
        expect(names(notes, "32 packets ... 16-beam Ouster, OS-1-16") and "4 full revolutions" in notes, f"{name}: {notes}")
        expect(len(head["frames"]) == 4 and len(head["lidars"]) == 1 and "missing" not in notes, f"{name}: {head['frames']}, {notes}")
        for frame in head["frames"]:
            scan = np.load(folder / frame["scan"])
            expect(scan["range"].shape == (16, 128) and abs((scan["range"] > 0).mean() - 2 / 3) < 0.01, f"{name}: {scan['range'].shape}")
            points, hit = returns(scan)
            expect_walls(name, points)
            expect(abs(scan["time"].min() + 0.05) < 1e-6 and abs(scan["time"].max() - 0.05 + 781250e-9) < 1e-6, f"{name}: times")
            ring = np.argsort(np.argsort(-ouster.elevation, kind="stable"), kind="stable")
            expect(np.abs(255 * scan["intensity"][hit] - (90 + np.argsort(ring)[scan["ring"][hit]])).max() < 1e-3, f"{name}: reflectivities")
        step = [b["time_s"] - a["time_s"] for a, b in zip(head["frames"], head["frames"][1:])]
        expect(np.abs(np.array(step) - 0.1).max() < 1e-6, f"{name}: frames {step} s apart")
        if moves:   # two rotations by 180 degrees leave x unchanged
            poses = np.loadtxt(folder / "poses.txt")
            expect(names(run("info", bag), "vehicle poses ... 'base_link' in 'map', /tf") and "/ouster/points" in notes, f"{name}: {notes}")
            expect(np.abs(np.diff(poses[:, 1]) - 0.5).max() < 1e-3 and np.abs(np.abs(poses[:, 4]) - 1).max() < 1e-6, f"{name}: {poses}")


def same_scans(name, one, other, most_s=0):
    """The scans of two logs must be equal, with times that differ by at most `most_s`."""
    (a, a_head, _), (b, b_head, _) = one, other
    expect(len(a_head["frames"]) == len(b_head["frames"]) > 1, f"{name}: {len(b_head['frames'])} scans, expected {len(a_head['frames'])}")
    for frame, twin in zip(a_head["frames"], b_head["frames"]):
        left, right = np.load(a / frame["scan"]), np.load(b / twin["scan"])
        for key in left.files:
            expect(key == "time" or np.array_equal(left[key], right[key]), f"{name}: {key} of {twin['scan']}")
        apart = np.abs(frame["time_s"] - twin["time_s"] + left["time"].astype(float) - right["time"])
        expect(apart.max() <= most_s, f"{name}: times differ by {apart.max()} s")


def test_livox():
    """Packets of a Mid-360, one in each of the three point formats, must become clouds of 0.1 s
    with the original points."""
    for kind in (1, 2, 3):
        stamped, truth = [], []
        for k in range(300):   # each packet takes 1 ms
            data, points = lidars.livox_packet(k, kind)
            truth.append(points)
            stamped += [(T0 + k * 1_000_000 + 40_000 * (k % 3), f) for f in captures.frames(data, port=56301)]
        capture = WORK / f"livox_{kind}.pcap"
        captures.write(capture, stamped)
        log, head, notes = convert(capture, "dataset.poses=none")
        expect(len(head["frames"]) in (2, 3), f"Livox, form {kind}: {len(head['frames'])} clouds")
        truth = np.concatenate(truth)
        for number, frame in enumerate(head["frames"]):
            scan = np.load(log / frame["scan"])
            points, hit = returns(scan)
            times = scan["time"][hit] + frame["time_s"]
            order, wanted = np.argsort(times, kind="stable"), truth[(truth[:, 3] >= 0.1 * number) & (truth[:, 3] < 0.1 * (number + 1))]
            expect(abs(len(points) - len(wanted)) <= 32, f"Livox, form {kind}: {len(points)} points, expected {len(wanted)}")
            n = min(len(points), len(wanted)) - 32
            apart = np.abs(points[order][:n] - wanted[:n, :3]).max()
            late = np.abs(times[order][:n] - times[order][0] - wanted[:n, 3] + wanted[0, 3]).max()
            expect(apart < 1e-5 and late < 1e-6, f"Livox, form {kind}: points by up to {apart} m, times by up to {late} s")


def test_captures():
    """A network capture of the packets of a bag must give the same log, also with additional
    traffic."""
    for product, how in zip((lidars.PRODUCTS[0], lidars.PRODUCTS[3], lidars.PRODUCTS[5]), ("pcap", "vlan", "fragments")):
        packets, _ = lidars.packets(product, 800)
        bag, capture = WORK / f"{product.name}.mcap", WORK / f"{product.name}_{how}.{'pcapng' if how == 'vlan' else 'pcap'}"
        bags.write_mcap(bag, messages(packets, "nebula_msgs/NebulaPackets"))
        other = [(packets[k][0] + 1000, captures.frame(b"$GPRMC" + bytes(548), port=8308)) for k in range(0, 400, 40)]
        frames = [(ns, f) for ns, data in packets
                  for f in captures.frames(data, vlan=how == "vlan", mtu=600 if how == "fragments" else 9000)]
        frames = sorted(frames + other + [(0, captures.stranger())], key=lambda f: f[0])
        captures.write(capture, [(T0 + ns, f) for ns, f in frames])
        log = convert(capture)
        same_scans(f"{product.name}, {how}", convert(bag), log)
        expect(names(log[2], f"{len(packets)} packets ... {product.name}"), f"{how}: {log[2]}")
        text = run("info", capture)
        expect("192.168.1.201:2368" in text and "other UDP" in text, f"info of {how}: {text}")
    test_livox()
    whole = capture.read_bytes()
    capture.write_bytes(whole[:-100])
    expect(names(run("info", capture), "packets ... byte"), "a capture that ends in a packet")
    captures.write(capture, [(T0 + ns, f) for ns, f in frames], cut={1200: 200})
    expect(names(run("info", capture), "1 packets ... truncated"), "a frame that was cut")
    capture.write_bytes(b"no capture at all")
    expect(names(run("info", capture, code=3), "read ... capture"), "a file that is none")
    captures.write(capture, [(T0, captures.frame(bytes(100)))])
    expect("no " in run("train", capture, "--out", WORK / "run", code=3), "a capture without a LiDAR")


def test_clock_of_gps():
    """A VLP-16 with GPS sends UTC. The capture is on TAI, 37 s ahead, and poses are on UTC."""
    hour_us = T0 // 1000 % 3_600_000_000
    packets, _ = lidars.packets(lidars.PRODUCTS[0], 800, zero_us=hour_us - 37_000_000)
    capture, poses = WORK / "gps.pcap", WORK / "gps_poses.txt"
    captures.write(capture, [(T0 + ns, captures.frame(data)) for ns, data in packets])
    poses.write_text("".join(f"{T0 / 1e9 - 37 + s:.3f} {10 * s:.3f} 0 0 1 0 0 0\n" for s in np.arange(-0.2, 1.6, 0.05)))
    folder, head, notes = convert(capture, f"dataset.poses={poses}")
    expect(names(notes, "37.000 s ahead"), f"{notes}")
    _, _, zero_s = returns_of(folder, head, False)
    apart = np.loadtxt(folder / "poses.txt")[:, 1] - 10 * (np.array([f["time_s"] for f in head["frames"]]) + zero_s)
    expect(len(apart) > 5 and np.abs(apart).max() < 1e-3, f"poses {apart} m apart")


def check_nothing_is_lost(capture):
    """A log must not replace itself, another kind of file, or a file of the same name without --force."""
    before = capture.read_bytes()
    run("convert", capture, "--out", capture, "--force", "--set", "dataset.max_range_m=200", code=2)
    expect(capture.read_bytes() == before, f"{capture.name} was replaced by itself")
    thesis, notes = WORK / "thesis.pcap", WORK / "noted.json"
    thesis.write_text("no capture")
    notes.write_text("{}")
    run("convert", capture, "--out", thesis, "--force", "--set", "dataset.max_range_m=200", code=2)
    run("convert", capture, "--out", notes.with_suffix(".pcap"), "--set", "dataset.max_range_m=200", code=2)
    expect(thesis.read_text() == "no capture" and notes.read_text() == "{}", "a file that is no capture was replaced")


def test_written_files():
    """`convert --out FILE.pcap` must write the angles of Hesai's lasers next to the packets."""
    for product in (lidars.PRODUCTS[0], lidars.PRODUCTS[5]):
        packets, _ = lidars.packets(product, 800)
        capture, again = WORK / f"{product.name}_first.pcap", WORK / f"{product.name}_again.pcap"
        captures.write(capture, [(T0 + ns, f) for ns, data in packets for f in captures.frames(data)])
        run("convert", capture, "--out", again, "--set", "dataset.max_range_m=200")
        expect(again.with_suffix(".csv").exists() == product.hesai, f"{product.name}: the angles of the lasers")
    check_nothing_is_lost(capture)


def test_network():
    """A network delivers packets late, twice, in fragments, and on several interfaces. The log must
    be the same as the log of the packets in order."""
    product = lidars.PRODUCTS[5]
    packets, _ = lidars.packets(product, 900)
    spaced = [(T0 + ns, data) for ns, data in packets]

    def capture(name, datagrams, **how):
        path = WORK / f"network_{name.replace(' ', '_')}.pcap"
        frames = [(ns, f) for ns, data in datagrams for f in captures.frames(data, **how)]
        captures.write(path, frames)
        return path

    plain = convert(capture("plain", spaced))
    swapped = list(spaced)
    for k in (300, 301, 430):
        swapped[k], swapped[k + 1] = swapped[k + 1], (swapped[k + 1][0] + 1000, swapped[k][1])
    # swaps the packets but not their stamps
    swapped[500], swapped[501] = (swapped[500][0], swapped[501][1]), (swapped[501][0], swapped[500][1])
    late = [p for p in spaced if p != spaced[400]]
    late.insert(405, (spaced[405][0] + 1000, spaced[400][1]))
    doubled = [p for k, p in enumerate(spaced) for _ in range(2 if k == 250 else 1)]
    twice = [(ns + 20_000 * again, data) for ns, data in spaced for again in (0, 1)]
    for name, datagrams, note in (("swapped", swapped, "packets ... order"), ("late", late, "1 packets ... order"),
                                  ("doubled", doubled, "1 packets ... twice"), ("all twice", twice, "900 packets ... twice")):
        log = convert(capture(name, datagrams))
        same_scans(name, plain, log, 2e-6)
        expect(names(log[2], note), f"{name}: {log[2]}")
    # Uses fragments. Each first fragment arrives twice, and the fragments of two
    # datagrams alternate.
    frames = []
    for a, b in zip(spaced[::2], spaced[1::2]):
        first, second = captures.frames(a[1], mtu=600), captures.frames(b[1], mtu=600)
        frames += [(a[0], first[0]), (a[0], second[0]), (a[0], first[0])]
        frames += [(a[0], f) for pair in zip(first[1:], second[1:]) for f in pair]
    path = WORK / "network_fragments.pcap"
    captures.write(path, frames)
    near = convert(path)
    expect(names(near[2], "900 packets ... XT32"), f"fragments: {near[2]}")
    expect(len(near[1]["frames"]) == len(plain[1]["frames"]), f"fragments: {near[2]}")
    for frame, twin in zip(plain[1]["frames"], near[1]["frames"]):
        left, right = np.load(plain[0] / frame["scan"]), np.load(near[0] / twin["scan"])
        expect(np.array_equal(left["range"], right["range"]), "fragments: ranges")
    # Uses the interface "any" of Linux: a packet is captured on each interface that it
    # passes.
    cooked = WORK / "network_any.pcap"
    captures.write(cooked, [(ns + 5000 * again, captures.cooked(f)) for ns, data in spaced for again in (0, 1) for f in captures.frames(data)], link=113)
    same_scans("any", plain, convert(cooked), 2e-6)
    six = WORK / "network_ipv6.pcap"
    captures.write(six, [(ns, f) for ns, data in spaced for f in captures.frames6(data, 700)])
    same_scans("IPv6", plain, convert(six), 2e-6)
    expect("[fe80::1]:2368" in run("info", six), "address of an IPv6 capture")
    packed = WORK / "network_packed.pcap.gz"
    packed.write_bytes(gzip.compress((WORK / "network_plain.pcap").read_bytes(), 1))
    same_scans("gzip", plain, convert(packed), 2e-6)
    cut = WORK / "network_cut.pcap.gz"
    cut.write_bytes(packed.read_bytes()[:-5000])
    expect(names(run("info", cut), "network_cut.pcap.gz ... gzip"), "a truncated gzip file")
    # The packets of two identical sensors must not be combined into a single sensor.
    mixed = sorted(spaced + [(T0 + ns + 130_000, d) for ns, d in lidars.packets(product, 900, zero_us=3_599_950_130)[0]])
    text = run("info", capture("two sensors", mixed), code=3)
    expect(names(text, "sensors ... mixed"), f"two sensors: {text}")
    text = run("info", capture("half", spaced[:90]), code=3)
    expect(names(text, "90 packets ... XT32") and names(text, "degrees ... revolution"), f"half a turn: {text}")
    text = run("info", capture("one", spaced[:1]), code=3)
    expect(names(text, "1 packets ... XT32"), f"one packet: {text}")


def test_sectors():
    """Tests sectors in which the sensor has no returns: firings without any return, and firings
    that the sensor omits."""
    product = lidars.PRODUCTS[5]
    packets, _ = lidars.packets(product, 900)
    blanked, shares = [], []
    # XT32: 12 bytes of header, then blocks of 130 bytes; the x axis is at 90 degrees
    for ns, data in packets:
        data = bytearray(data)
        for at in range(12, 12 + 8 * 130, 130):
            if 225 <= data[at] / 100 + data[at + 1] * 2.56 < 315:
                data[at + 2:at + 130] = bytes(128)
            ranges = np.frombuffer(bytes(data[at + 2:at + 130]), "<u2")[::2]
            shares.append((ranges > 0).mean())
        blanked.append((ns, bytes(data)))
    bag = WORK / "blanked.mcap"
    bags.write_mcap(bag, messages(blanked, "nebula_msgs/NebulaPackets"))
    log, head, notes = convert(bag)
    for frame in head["frames"]:
        scan = np.load(log / frame["scan"])
        azimuth = np.degrees(np.arctan2(scan["directions"][..., 1], scan["directions"][..., 0]))
        hit = scan["range"] > 0
        expect(abs(hit.mean() - np.mean(shares[:2000 * 3])) < 0.002, f"{hit.mean()} returns, the packets have {np.mean(shares[:6000])}")
        expect(not hit[np.abs(azimuth) > 136].any(), "returns in a sector without any")
        expect(0.24 < (np.abs(azimuth) > 135).mean() < 0.26, "rays of the sector are missing")
        expect(np.abs(scan["time"]).max() < 0.052, f"times up to {np.abs(scan['time']).max()} s")

    product = lidars.PRODUCTS[1]
    expect(product.name == "VLP-32C", product.name)
    packets, _ = lidars.packets(product, 700)
    full, full_head, notes = convert_bag("full_turns", packets)
    fired = []   # a sensor that is limited to 270 to 90 degrees fills its packets with the remaining firings
    for k, (ns, data) in enumerate(packets):
        for b in range(12):
            block = data[100 * b:100 * b + 100]
            azimuth = (block[2] + 256 * block[3]) / 100
            if azimuth <= 90 or azimuth >= 270:
                fired.append(((12 * k + b) * product.cycle_us, block))
    limited = []
    for at in range(0, len(fired) - 11, 12):
        us = fired[at][0]
        limited.append((round(us * 1000), b"".join(block for _, block in fired[at:at + 12]) +
                        struct.pack("<I", round(us + 3_599_950_000) % 3_600_000_000) + packets[0][1][1204:]))
    log, head, notes = convert_bag("half_turns", limited)
    expect(names(notes, "fires in 18"), f"half turns: {notes}")
    expect(len(head["frames"]) >= 3, f"half turns: {notes}")
    full_s = np.array([f["time_s"] for f in full_head["frames"]]) + zero_of(full_head)
    for frame in head["frames"]:
        scan = np.load(log / frame["scan"])
        columns = lidars.TURN_S / product.cycle_us * 1e6
        expect(abs(scan["range"].shape[1] - columns / 2) < 8, f"half turns: {scan['range'].shape}")
        at = np.abs(full_s - frame["time_s"] - zero_of(head)).argmin()
        whole = np.load(full / full_head["frames"][at]["scan"])
        shift = full_s[at] - frame["time_s"] - zero_of(head)
        key = lambda s, dt: {(int(r), round(float(d), 4), round((float(t) + dt) / 20e-6)) for r, d, t in zip(
            s["ring"][s["range"] > 0], s["range"][s["range"] > 0], s["time"][s["range"] > 0])}
        half, all_of_turn = key(scan, 0.0), key(whole, shift)
        near = all_of_turn | {(r, d, t + e) for r, d, t in all_of_turn for e in (-1, 1)}
        expect(len(half - near) <= 64, f"half turns: {len(half - near)} of {len(half)} returns are not those of full turns")
        expect(abs(len(half) / len(all_of_turn) - 0.5) < 0.01, f"half turns: {len(half)} returns, {len(all_of_turn)} in full turns")


def convert_bag(name, packets):
    bag = WORK / f"{name}.mcap"
    bags.write_mcap(bag, messages(packets, "nebula_msgs/NebulaPackets"))
    return convert(bag)


def test_others():
    """Reads recordings of other programs. The expected numbers are taken from the packets, or from
    the manufacturer's SDK."""
    shared = os.environ.get("RELIDAR_SHARED")
    data = (pathlib.Path(shared) if shared else pathlib.Path(__file__).resolve().parents[2].parent / "shared") / "data" / "others"
    if not data.is_dir():
        print(f"skipped: {data} is not there")
        return
    for name, turns, share, note in (("derived/dead-sector/xt32_rear_blanked.pcap", 3, 0.712, ""),
                                     ("derived/dead-sector/xt32_front_blanked.pcap", 3, 0.716, ""),
                                     ("derived/packet-order/xt32_swap_middle.pcap", 3, 0.95, "1 packets ... order"),
                                     ("derived/packet-order/xt32_dup_middle.pcap", 3, 0.95, "1 packets ... twice"),
                                     ("derived/packet-order/xt32_all_dup.pcap", 3, 0.95, "2000 packets ... twice"),
                                     ("derived/packet-order/os1_all_dup.pcap", 3, None, "192 packets ... twice"),
                                     ("derived/vlp32-fov/raw.pcap", 4, None, "181 degrees"),
                                     ("nebula-velodyne-vlp32/1713492677464078412", 4, None, "181 degrees")):
        log, head, notes = convert(data / name)
        expect(len(head["frames"]) == turns and names(notes, note), f"{name}: {len(head['frames'])} turns, {notes}")
        for frame in head["frames"]:
            scan = np.load(log / frame["scan"])
            if "vlp32" in name:
                expect(abs(scan["range"].size - 29_000) < 300, f"{name}: {scan['range'].size} rays")
            if share:
                expect(abs((scan["range"] > 0).mean() - share) < 0.0015, f"{name}: {(scan['range'] > 0).mean()} returns")
    for name, reason in (("ouster-duplicate_id/duplicate_id.pcap", "128-beam Ouster, OS-2-128"),
                         ("ouster-OS-1-128_fusa/OS-1-128_767798045_1024x10_20230712_120049.pcap", "8 packets ... 128-beam Ouster, OS-1-128"),
                         ("ouster-same_ports/legacy/same_ports_legacy.pcap", "1 packets ... 64-beam Ouster, OS-1-64-AH"),
                         ("ouster-shot_limiting/shot_limiting_test.pcap", "5 degrees"),
                         ("gadomski-vlp16/position.pcap", "1 datagrams")):
        text = run("info", data / name, code=3)
        expect(names(text, reason), f"{name}: {text}")


run_tests(test_bags, test_alternating, test_strangers, test_ousters, test_sectors,
          *((test_captures, test_clock_of_gps, test_written_files, test_network, test_others) if "pcap" in sys.argv[3:] else ()))
