// SPDX-License-Identifier: Apache-2.0
// Reads recordings with packages of other projects (npm: @mcap/core, fzstd, protobufjs,
// @foxglove/rosmsg, @foxglove/rosmsg2-serialization). Decodes messages with the schemas
// in the files, and builds a tree of frames like a player.
"use strict";
const fs = require("fs");
const path = require("path");
const { createRequire } = require("module");

/** Loads the packages in a folder's node_modules. Exits with 77 if one is missing. */
function packages(modules) {
    const from = createRequire(path.resolve(modules, "reader.cjs"));
    try {
        return {
            core: from("@mcap/core"),
            protobuf: from("protobufjs"),
            descriptor: from("protobufjs/ext/descriptor"),
            rosmsg: from("@foxglove/rosmsg"),
            serialization: from("@foxglove/rosmsg2-serialization"),
            decompressHandlers: { zstd: (bytes) => from("fzstd").decompress(bytes) },
        };
    } catch (error) {
        console.log(`no reader: ${error.message.split("\n")[0]}`);
        process.exit(77);
    }
}

/** Gives the reader access to parts of a file. */
class File {
    constructor(name) {
        this.bytes = fs.readFileSync(name);
    }
    async size() {
        return BigInt(this.bytes.length);
    }
    async read(offset, length) {
        return new Uint8Array(this.bytes.subarray(Number(offset), Number(offset + length)));
    }
}

function decoder(npm, schema) {
    if (schema.encoding === "protobuf") {
        const root = npm.protobuf.Root.fromDescriptor(npm.descriptor.FileDescriptorSet.decode(schema.data));
        const type = root.lookupType(schema.name);
        return (data) => type.toObject(type.decode(data), { longs: Number, defaults: true });
    }
    const reader = new npm.serialization.MessageReader(npm.rosmsg.parse(Buffer.from(schema.data).toString(), { ros2: true }));
    return (data) => reader.readMessage(data);
}

/**
 * Returns the messages in the order of the file as {topic, type, time, value}, the
 * channels, and the metadata of the file. Times are nanoseconds of the log.
 */
async function read(npm, file, check) {
    const name = path.basename(file);
    const reader = await npm.core.McapIndexedReader.Initialize({ readable: new File(file), decompressHandlers: npm.decompressHandlers });
    let indexed = 0;
    for await (const _ of reader.readMessages()) ++indexed;
    check(`${name}: statistics count ${reader.statistics.messageCount} messages, the index ${indexed}`,
          Number(reader.statistics.messageCount) === indexed);
    const records = {};
    for await (const record of reader.readMetadata()) records[record.name] = record.metadata;
    check(`${name}: no metadata of relidar`, records.relidar !== undefined);
    const stream = new npm.core.McapStreamReader({ validateCrcs: true, decompressHandlers: npm.decompressHandlers });   // checks checksums of chunks
    stream.append(fs.readFileSync(file));
    const decoders = new Map(), messages = [];
    for (let record; (record = stream.nextRecord());) {
        if (record.type !== "Message") continue;
        const channel = reader.channelsById.get(record.channelId), schema = reader.schemasById.get(channel.schemaId);
        if (!decoders.has(channel.id)) decoders.set(channel.id, decoder(npm, schema));
        messages.push({ topic: channel.topic, type: schema.name, time: record.logTime, value: decoders.get(channel.id)(record.data) });
    }
    check(`${name}: the stream has ${messages.length} messages, the index ${indexed}`, messages.length === indexed && stream.done());
    const channels = Object.fromEntries([...reader.channelsById.values()].map((c) => [c.topic, c]));
    return { name, messages, channels, records, shift: Number(records.relidar?.get("time_shift_s")) };
}

/** Returns a time of ROS or Foxglove in nanoseconds. */
function nanoseconds(t) {
    return BigInt(t.sec ?? t.seconds) * 1000000000n + BigInt(t.nsec ?? t.nanosec ?? t.nanos);
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const xyz = (v) => [v.x, v.y, v.z];

/** Rotates v by the quaternion q (x y z w): q v q*. */
function rotate(q, v) {
    const t = cross(q, v).map((x) => 2 * x), u = cross(q, t);
    return v.map((x, i) => x + q[3] * t[i] + u[i]);
}
const conjugate = (q) => [-q[0], -q[1], -q[2], q[3]];
function apply(pose, v) {
    return rotate(pose.q, v).map((x, i) => x + pose.t[i]);
}

/** Interpolates two poses like tf2: translations linearly, rotations by slerp. */
function interpolate(a, b, s) {
    const dot = a.q.reduce((sum, x, i) => sum + x * b.q[i], 0), sign = dot < 0 ? -1 : 1, angle = Math.acos(Math.min(1, Math.abs(dot)));
    const [wa, wb] = angle < 1e-9 ? [1 - s, s] : [Math.sin((1 - s) * angle) / Math.sin(angle), Math.sin(s * angle) / Math.sin(angle)];
    const q = a.q.map((x, i) => wa * x + sign * wb * b.q[i]), length = Math.hypot(...q);
    return { t: a.t.map((x, i) => x + s * (b.t[i] - x)), q: q.map((x) => x / length) };
}

/** Transforms of all messages that were read so far. */
class Frames {
    constructor() {
        this.of = new Map();   // child -> {parent, isStatic, times, poses}
    }
    add(parent, child, time, translation, rotation, isStatic) {
        if (!this.of.has(child)) this.of.set(child, { parent, isStatic, times: [], poses: [] });
        const edge = this.of.get(child);
        if (edge.parent !== parent) throw new Error(`${child} has two parents, ${edge.parent} and ${parent}`);
        const pose = { t: xyz(translation), q: [...xyz(rotation), rotation.w] };
        if (isStatic) edge.times.length = edge.poses.length = 0;
        edge.times.push(time), edge.poses.push(pose);
    }
    /** Reads messages of /tf and /tf_static of both kinds. */
    hear({ topic, value }) {
        for (const t of value.transforms ?? [value])
            this.add(t.header?.frame_id ?? t.parent_frame_id, t.child_frame_id, nanoseconds(t.header?.stamp ?? t.timestamp),
                     (t.transform ?? t).translation, (t.transform ?? t).rotation, topic === "/tf_static");
    }
    edgeAt(edge, time) {
        const { times, poses } = edge;
        if (edge.isStatic) return poses[0];
        if (time < times[0] || time > times[times.length - 1])
            throw new Error(`no transform at ${time}, only from ${times[0]} to ${times[times.length - 1]}`);
        let low = 0, high = times.length - 1;
        while (high - low > 1) times[(low + high) >> 1] <= time ? low = (low + high) >> 1 : high = (low + high) >> 1;
        if (times[high] <= time) low = high;
        if (low === high) return poses[low];
        return interpolate(poses[low], poses[high], Number(time - times[low]) / Number(times[high] - times[low]));
    }
    /**
     * Returns the transforms from a frame to the world at a time. Does not extrapolate.
     * @return edges, innermost first
     */
    chain(frame, time) {
        const edges = [];
        for (let child = frame; child !== "world"; child = this.of.get(child).parent) {
            if (!this.of.has(child)) throw new Error(`no transform of ${child}`);
            edges.push(this.edgeAt(this.of.get(child), time));
        }
        return edges;
    }
    toWorld(frame, time, point) {
        return this.chain(frame, time).reduce((v, pose) => apply(pose, v), point);
    }
}

/** Returns the columns of a ply file: x y z intensity ring time instance. */
function readPly(name) {
    const bytes = fs.readFileSync(name);
    const end = bytes.indexOf("end_header\n") + 11;
    const header = bytes.subarray(0, end).toString("latin1").split("\n");
    const properties = header.filter((l) => l.startsWith("property ")).map((l) => l.split(" ").slice(1));
    const count = Number(header.find((l) => l.startsWith("element vertex")).split(" ")[2]);
    const readers = {
        float: [4, (at) => bytes.readFloatLE(at)],
        double: [8, (at) => bytes.readDoubleLE(at)],
        int: [4, (at) => bytes.readInt32LE(at)],
        uint16: [2, (at) => bytes.readUInt16LE(at)],
        uint8: [1, (at) => bytes.readUInt8(at)],
    };
    const rows = [];
    for (let i = 0, at = end; i < count; ++i) {
        const row = {};
        for (const [type, field] of properties) {
            row[field] = readers[type][1](at);
            at += readers[type][0];
        }
        rows.push(row);
    }
    return rows;
}

const kFoxglove = { 1: (b, i) => b.readUInt8(i), 3: (b, i) => b.readUInt16LE(i), 6: (b, i) => b.readInt32LE(i), 7: (b, i) => b.readFloatLE(i) };
const kRos = { 2: (b, i) => b.readUInt8(i), 4: (b, i) => b.readUInt16LE(i), 6: (b, i) => b.readUInt32LE(i), 7: (b, i) => b.readFloatLE(i) };

/**
 * Returns the points of a foxglove.PointCloud or a sensor_msgs/PointCloud2. Uses the
 * fields that the message describes.
 */
function points(cloud) {
    const bytes = Buffer.from(cloud.data), stride = cloud.point_stride ?? cloud.point_step;
    const readers = cloud.point_stride ? kFoxglove : kRos;
    const rows = [];
    for (let at = 0; at + stride <= bytes.length; at += stride) {
        const row = {};
        for (const field of cloud.fields) row[field.name] = readers[field.datatype ?? field.type](bytes, at + Number(field.offset));
        rows.push(row);
    }
    return rows;
}

module.exports = { packages, read, nanoseconds, Frames, readPly, points, interpolate, rotate, conjugate, xyz };
