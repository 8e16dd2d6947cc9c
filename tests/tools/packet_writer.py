# SPDX-License-Identifier: Apache-2.0
"""Writes packets of spinning LiDARs inside a box of walls, from the manuals of the manufacturers,
for tests. The only data from relidar are the angles of the lasers. The head turns clockwise at 10
Hz and is at the manufacturer's azimuth 0 at time 0. Velodyne: VLP-16 63-9243, VLP-32C 63-9325,
HDL-32E 63-9113. Hesai: user manuals of Pandar40P, Pandar64 and PandarXT-32. Ouster: firmware user
manual, "Lidar Data"."""
import csv
import pathlib
import struct

import numpy as np

WALLS = np.array([22.0, 14.0, 6.0])   # distance of the walls from the sensor in metres along x, y and z
TABLES = pathlib.Path(__file__).parents[2] / "src" / "log" / "sensor" / "tables"
TURN_S = 0.1


# Vertical offsets of the lasers of a VLP-16 in mm (manual 63-9243), added to the heights of points
VLP16_MM = [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]


def read_beams(name):
    with open(TABLES / (name + ".csv")) as table:
        return list(csv.DictReader(line for line in table if not line.startswith("#")))


class Blocks:
    """A product of Velodyne or Hesai whose packets consist of blocks."""

    def __init__(self, name, lasers, unit_mm, cycle_us, hesai=False, first=0):
        self.name, self.lasers, self.unit_mm, self.cycle_us, self.hesai, self.first = name, lasers, unit_mm, cycle_us, hesai, first
        self.blocks = {"Pandar40P": 10, "Pandar64": 6, "XT32": 8}.get(name, 12)   # per packet
        self.per_block = 2 if name == "VLP-16" else 1   # firings
        rows = read_beams(name)
        self.elevation, self.azimuth, self.offset_us = np.zeros((3, lasers))
        self.up_m = np.array(VLP16_MM) / 1000 if name == "VLP-16" else np.zeros(lasers)
        for row in rows:
            k = int(row["channel"]) - first
            self.elevation[k] = float(row["elevation_deg"])
            self.azimuth[k] = -float(row.get("azimuth_offset_deg") or 0)   # manufacturers count clockwise
            self.offset_us[k] = float(row.get("firing_offset_us") or 0)


PRODUCTS = [Blocks("VLP-16", 16, 2, 55.296), Blocks("VLP-32C", 32, 4, 55.296), Blocks("HDL-32E", 32, 2, 46.08),
            Blocks("Pandar40P", 40, 4, 55.56, True, 1), Blocks("Pandar64", 64, 4, 55.56, True, 1), Blocks("XT32", 32, 4, 50.0, True, 1)]


def directions(product, laser, azimuth_deg):
    """Returns the directions of the lasers in the frame of the driver.
    @param azimuth_deg azimuth of the head, clockwise"""
    a, e = np.radians(azimuth_deg + product.azimuth[laser]), np.radians(product.elevation[laser])
    x, y = (np.sin(a), np.cos(a)) if product.hesai else (np.cos(a), -np.sin(a))
    return np.stack([np.cos(e) * x, np.cos(e) * y, np.sin(e)], -1)


def to_walls(d, start=0.0):
    with np.errstate(divide="ignore"):
        return ((np.copysign(WALLS, d) - start) / d).min(-1)


def firing(product, number, dual):
    """Returns (range mm, reflectivity) of each laser and return as the packet stores them. Also
    returns the truth: (time, azimuth of the head, laser, mm, reflectivity, number of the return).
    Every third ray is dropped. Of two returns, the later return in the packet is weaker and 1.5 m
    nearer."""
    lasers = np.arange(product.lasers)
    t = number * product.cycle_us * 1e-6 + product.offset_us * 1e-6
    r = to_walls(directions(product, lasers, t / TURN_S * 360), np.multiply.outer(product.up_m, [0.0, 0.0, 1.0])) * 1000
    mm = np.rint(r / product.unit_mm).astype(int) * product.unit_mm
    mm[(number + lasers) % 3 == 0] = 0
    bright = 90 + lasers
    values, truth = [], []
    for k in lasers:
        two = dual and mm[k] > 0 and number % 5 == 0
        values.append(((mm[k], bright[k]), (mm[k] - 1500, 40) if two else (mm[k], bright[k])))
        if mm[k] > 0:
            truth.append((t[k], t[k] / TURN_S * 360, k, mm[k] / 1000, bright[k], 0))
            if two:
                truth.append((t[k], t[k] / TURN_S * 360, k, mm[k] / 1000 - 1.5, 40, 1))
    return values, truth


class Ouster:
    """An Ouster sensor with 16 beams, which are not sorted by elevation, 128 columns per turn, and
    the profile with a single return."""
    lasers, columns, per_packet, start_m = 16, 128, 16, 0.0158
    elevation = np.array([15.0 - 2 * (row ^ 1) for row in range(16)])
    azimuth = np.where(np.arange(16) % 2 == 0, 2.8125, -2.8125)

    def metadata(self, port=7502):
        return {"beam_altitude_angles": self.elevation.tolist(), "beam_azimuth_angles": self.azimuth.tolist(), "prod_line": "OS-1-16",
                "lidar_origin_to_beam_origin_mm": 1000 * self.start_m, "lidar_mode": "128x10", "udp_port_lidar": port,
                "data_format": {"columns_per_frame": 128, "columns_per_packet": 16, "pixels_per_column": 16, "column_window": [0, 127],
                                "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16"}}

    def column(self, number):
        """Returns (mm, reflectivity) of each row of a column. The head faces backward in column 0,
        and x is forward in relidar's frame. Every third ray is dropped."""
        head = np.pi - 2 * np.pi * number / self.columns
        a, e = head - np.radians(self.azimuth), np.radians(self.elevation)
        d = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
        start = self.start_m * np.array([np.cos(head), np.sin(head), 0.0])
        mm = np.rint(1000 * (to_walls(d, start) + self.start_m)).astype(int)
        mm[(number + np.arange(self.lasers)) % 3 == 0] = 0
        return mm, 90 + np.arange(self.lasers)

    def packets(self, turns):
        """Returns (time of the last column in ns, bytes) of each packet."""
        out = []
        for k in range(turns * self.columns // self.per_packet):
            body = struct.pack("<HHI", 1, k // 8, 0).ljust(32, b"\0")
            for number in range(k * self.per_packet, (k + 1) * self.per_packet):
                mm, bright = self.column(number % self.columns)
                body += struct.pack("<QHH", self.time_ns(number), number % self.columns, 1)
                body += b"".join(struct.pack("<IBBHHH", r, q, 0, 500, 16, 0) for r, q in zip(mm, bright))
            out.append((self.time_ns(number), body + bytes(32)))
        return out

    def time_ns(self, number):
        return 7_000_000_000 + number * 781_250


def packets(product, n, dual=False, lost=(), zero_us=3_599_950_000):
    """Returns (ns after time 0 of the first firing's clock, bytes) of n packets, and the truth of
    the packets that are not lost."""
    flag = {"Pandar64": b"", "XT32": b""}.get(product.name, b"\xff\xee")
    pad = b"\0" if product.name == "XT32" else b""
    out, truths, number = [], [], 0
    for k in range(n):
        body, truth, first = b"", [], number
        for b in range(0, product.blocks, 2 if dual else 1):
            azimuth = round(number * product.cycle_us * 1e-6 / TURN_S * 36000) % 36000
            both = [flag + struct.pack("<H", azimuth)] * 2
            for _ in range(product.per_block):
                values, t = firing(product, number, dual)
                truth += t
                number += 1
                for i in (0, 1):
                    both[i] += b"".join(struct.pack("<HB", v[i][0] // product.unit_mm, v[i][1] if v[i][0] else 0) + pad for v in values)
            body += both[0] + (both[1] if dual else b"")
        mode = 0x39 if dual else 0x37
        last_us, first_us = (number - 1) * product.cycle_us, first * product.cycle_us
        if not product.hesai:
            time_us = first_us
            code = {"VLP-16": 0x22, "VLP-32C": 0x28, "HDL-32E": 0x21}[product.name]
            data = body + struct.pack("<IBB", round(time_us + zero_us) % 3_600_000_000, mode, code)
        else:
            # According to the manuals, a laser fires at the start of its block plus its
            # time offset, the first at -54.67 (-54.668, +0.368) us.
            block, own = {"Pandar40P": (-28.58, -54.67), "Pandar64": (-42.58, -54.668), "XT32": (5.632, 0.368)}[product.name]
            time_us = last_us - block - own
            stamp = struct.pack("<I", round(time_us + zero_us) % 1_000_000)
            if product.name == "XT32":
                data = (bytes.fromhex("eeff06010000") + bytes([32, 8, 0, 4, 1 + dual, 0]) + body + bytes(10) + bytes([mode]) +
                        struct.pack("<H6B", 600, 123, 11, 14, 1, 2, 3) + stamp + b"\x42" + struct.pack("<I", k))
            else:
                head = bytes([0xee, 0xff, 64, 6, 0, 4, 0, 0]) if product.name == "Pandar64" else b""
                data = (head + body + bytes(8) + struct.pack("<H", 600) + stamp + bytes([mode, 0x42, 23, 11, 14, 1, 2, 3]) +
                        struct.pack("<I", k))
        if k not in lost:
            out.append((round(time_us * 1000), data))
            truths += truth
    return out, np.array(truths)


class Alternating:
    """A product whose lasers fire in two alternating sequences: QT128, or OT128 in high resolution.
    The firing times are read from the tables of relidar. The positions of the fields are taken from
    Hesai's manuals."""
    lasers = 128

    def __init__(self, name, arrays, cycle_us, start_us):
        self.name, self.cycle_us, self.start_us = name, cycle_us, start_us
        layouts = (TABLES.parents[2] / "read" / "packets" / "block_layouts.hpp").read_text()
        self.offset_us = np.array([[int(v) / 1000 for v in layouts.split(f"LaserFiringTimes {array} = {{")[1].split("}")[0].split(",")] for array in arrays])
        self.elevation, self.azimuth = np.zeros((2, self.lasers))
        for row in read_beams(name):
            self.elevation[int(row["channel"]) - 1] = float(row["elevation_deg"])
            self.azimuth[int(row["channel"]) - 1] = -float(row["azimuth_offset_deg"])

    hesai = True

    def block(self, number):
        """Returns (range values, truth) of a block. The truth has a row (seconds, azimuth of the
        beam in degrees, laser, metres) for each return. Every third firing laser has no return."""
        offset_us = self.offset_us[number % 2]
        lasers = np.arange(self.lasers)
        t = (number * self.cycle_us + offset_us) * 1e-6
        values = np.rint(to_walls(directions(self, lasers, t / TURN_S * 360)) * 250).astype(int)
        values[((number // 2 + lasers) % 3 == 0) | (offset_us < 0)] = 0
        hit = values > 0
        return values, np.column_stack([t, t / TURN_S * 360 + self.azimuth, lasers, values / 250])[hit]

    def packets(self, n, dual):
        out, truths = [], []
        for k in range(n):
            numbers = [k] if dual else [2 * k, 2 * k + 1]
            body = b""
            for number in numbers * (2 if dual else 1):
                values, truth = self.block(number)
                azimuth = round(number * self.cycle_us * 1e-6 / TURN_S * 36000) % 36000
                unit = (lambda v: struct.pack("<HBB", v, 90 * (v > 0), 0)) if self.name == "QT128" else (lambda v: struct.pack("<HB", v, 90 * (v > 0)))
                body += struct.pack("<H", azimuth) + b"".join(unit(v) for v in values)
            truths += [self.block(number)[1] for number in numbers]
            time_us = numbers[-1] * self.cycle_us - self.start_us
            stamp = struct.pack("<I", round(time_us + 950_000) % 1_000_000)
            mode, clock = bytes([0x3b if dual else 0x37]), struct.pack("<H6B", 600, 123, 11, 14, 1, 2, 3)
            if self.name == "QT128":
                data = (bytes.fromhex("eeff03020000") + bytes([128, 2, 0, 4, 1 + dual, 5]) + body + bytes(4 + 17 + 5) + bytes([1 - k % 2]) + bytes(6) + mode +
                        clock + stamp + b"\x42" + struct.pack("<I", k) + bytes(4))
            else:
                states = (k % 2) << 14 if dual else 1 << 12
                data = (bytes.fromhex("eeff01040000") + bytes([128, 2, 0, 4, 1 + dual, 7]) + body + bytes(4 + 17 + 9) + struct.pack("<H", states) + b"\0" + mode +
                        clock + stamp + b"\x42" + struct.pack("<I", k) + bytes(22 + 4))
            out.append((round(time_us * 1000), data))
        return out, np.concatenate(truths)


ALTERNATING = [Alternating("QT128", ("kQt128Loop1", "kQt128Loop2"), 1000 / 9, 9.0),
               Alternating("OT128", ("kOt128State0", "kOt128State1"), 250 / 9, 43.346)]


def livox_packet(number, kind):
    """Returns a packet of 32 points in 1 ms in the protocol of Livox SDK2, and its points: x, y, z
    in metres and seconds. Every eighth ray has no return.
    @param kind 1: mm, 2: cm, 3: range and angles"""
    body, points = b"", []
    for i in range(32):
        k = 32 * number + i
        azimuth, from_z, mm = (137 * k) % 36000, 6000 + (41 * k) % 6000, 5000 + k % 700
        if k % 8 == 0:
            mm = 0
        a, z = np.radians(azimuth / 100), np.radians(from_z / 100)
        p = mm / 1000 * np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)])
        if kind == 3:
            body += struct.pack("<IHHBB", mm, from_z, azimuth, k % 256, 0)
        else:
            q = np.rint(p * (1000 if kind == 1 else 100)).astype(int)
            p = q / (1000 if kind == 1 else 100)
            body += struct.pack("<iiiBB" if kind == 1 else "<hhhBB", *q, k % 256, 0)
        if mm:
            points.append((*p, 1e-3 * (number + i / 32)))
    head = struct.pack("<BHHHHBBB12xIQ", 0, 36 + len(body), 10000, 32, number, number // 100, kind, 1, 0, 5_000_000_000 + number * 1_000_000)
    return head + body, np.array(points)
