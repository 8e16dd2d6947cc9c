# SPDX-License-Identifier: Apache-2.0
"""Writes captures of a network for tests, from the descriptions of the formats: pcap with
nanoseconds, pcapng (draft-ietf-opsawg-pcapng), Ethernet frames with 802.1Q tags, IPv4 with
fragments (RFC 791), UDP."""
import struct

SENDER, RECEIVER = bytes([192, 168, 1, 201]), bytes([255, 255, 255, 255])
_identification = 0


def ethernet(packet, vlan=False, kind=0x0800):
    tag = struct.pack(">HH", 0x8100, 7) if vlan else b""
    # Ethernet pads short frames
    return (bytes(6) + bytes(6) + tag + struct.pack(">H", kind) + packet).ljust(60, b"\0")


def ip(payload, protocol=17, identification=0, offset=0, more=False):
    return struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(payload), identification, (0x2000 if more else 0) | offset // 8, 64, protocol, 0) + \
        SENDER + RECEIVER + payload


def frames(data, port=2368, vlan=False, mtu=9000):
    """Returns the frames of a datagram. Each frame has at most `mtu` bytes of IP."""
    global _identification
    _identification = (_identification + 1) % 65536
    datagram = struct.pack(">HHHH", 2368, port, 8 + len(data), 0) + data
    size = (mtu - 20) // 8 * 8
    return [ethernet(ip(datagram[at:at + size], 17, _identification, at, at + size < len(datagram)), vlan)
            for at in range(0, len(datagram), size)]


def frame(data, port=2368):
    return frames(data, port)[0]


def frames6(data, mtu):
    """Returns the frames of a datagram in IPv6 (RFC 8200). A datagram longer than `mtu` is sent in
    fragments."""
    global _identification
    _identification += 1
    datagram = struct.pack(">HHHH", 2368, 2368, 8 + len(data), 0) + data
    addresses = bytes.fromhex("fe80" + 13 * "00" + "01" + "ff02" + 13 * "00" + "01")
    size = (mtu - 48) // 8 * 8
    out = []
    for at in range(0, len(datagram), size):
        part = struct.pack(">BBHI", 17, 0, at | (at + size < len(datagram)), _identification) + datagram[at:at + size]
        out.append(ethernet(struct.pack(">IHBB", 6 << 28, len(part), 44, 64) + addresses + part, kind=0x86dd))
    return out


def cooked(frame):
    """Converts a frame to the form in which Linux captures it on the interface "any"
    (LINKTYPE_LINUX_SLL)."""
    return struct.pack(">HHH8s", 0, 1, 6, b"") + frame[12:]


def stranger():
    """Returns an ARP request, which readers must ignore."""
    return ethernet(bytes(28), kind=0x0806)


def write(path, stamped, cut={}, link=1):
    """Writes a capture. Files named `.pcapng` have this format, and all others are pcap.
    @param stamped (ns, frame) in order
    @param cut number of captured bytes, for each frame number
    @param link link type of a pcap"""
    with open(path, "wb") as out:
        if path.suffix == ".pcapng":
            section = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)
            interface = struct.pack("<HHI", 1, 0, 0) + struct.pack("<HHB3x", 9, 1, 9) + struct.pack("<HH", 0, 0)   # nanoseconds
            for kind, body in ((0x0A0D0D0A, section), (1, interface)):
                out.write(struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12))
        else:
            out.write(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 262144, link))
        for number, (ns, data) in enumerate(stamped):
            kept = data[:cut.get(number, len(data))]
            if path.suffix == ".pcapng":
                body = struct.pack("<IIIII", 0, ns >> 32, ns & 0xFFFFFFFF, len(kept), len(data)) + kept + bytes(-len(kept) % 4)
                out.write(struct.pack("<II", 6, len(body) + 12) + body + struct.pack("<I", len(body) + 12))
            else:
                out.write(struct.pack("<IIII", ns // 10**9, ns % 10**9, len(kept), len(data)) + kept)
