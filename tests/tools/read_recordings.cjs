// SPDX-License-Identifier: Apache-2.0
// Reads scans.mcap and rosbag.mcap of a rendering with the readers of others (npm: @mcap/core, protobufjs, @foxglove/rosmsg,
// @foxglove/rosmsg2-serialization), decoding messages by the schemas in the files, and compares them with the ply files and scans.json
// beside them.
//
//   node read_recordings.cjs NODE_MODULES FOLDER
//
// Prints what is wrong; exit code 1 where anything is, 77 where a package is missing.
"use strict";
const fs = require("fs");
const path = require("path");
const { createRequire } = require("module");

const [modules, folder] = process.argv.slice(2);
const from = createRequire(path.resolve(modules, "reader.cjs"));
let core, protobuf, descriptor, rosmsg, serialization;
try {
    core = from("@mcap/core");
    protobuf = from("protobufjs");
    descriptor = from("protobufjs/ext/descriptor");
    rosmsg = from("@foxglove/rosmsg");
    serialization = from("@foxglove/rosmsg2-serialization");
} catch (error) {
    console.log(`no reader: ${error.message.split("\n")[0]}`);
    process.exit(77);
}

const failures = [];
function check(what, good) {
    if (!good) failures.push(what);
}

/** A file that the reader asks for pieces of. */
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

/** Messages by topic, decoded; the index is what finds them. */
async function read(name, decoder) {
    const reader = await core.McapIndexedReader.Initialize({ readable: new File(path.join(folder, name)) });
    const topics = {};
    const decoders = new Map();
    for await (const message of reader.readMessages()) {
        const channel = reader.channelsById.get(message.channelId);
        if (!decoders.has(channel.id)) decoders.set(channel.id, decoder(reader.schemasById.get(channel.schemaId)));
        (topics[channel.topic] ??= []).push({ time: message.logTime, value: decoders.get(channel.id)(message.data) });
    }
    const total = Object.values(topics).reduce((sum, messages) => sum + messages.length, 0);
    check(`${name}: statistics count ${reader.statistics.messageCount} messages, found ${total}`,
          Number(reader.statistics.messageCount) === total);
    let metadata;
    for await (const record of reader.readMetadata({ name: "relidar" })) metadata = record.metadata;
    check(`${name}: no metadata of relidar`, metadata !== undefined);
    // everything once more, without the index: the stream reader checks checksums of chunks too
    const stream = new core.McapStreamReader({ validateCrcs: true });
    stream.append(fs.readFileSync(path.join(folder, name)));
    let streamed = 0;
    for (let record; (record = stream.nextRecord());) streamed += record.type === "Message";
    check(`${name}: the stream has ${streamed} messages, the index ${total}`, streamed === total && stream.done());
    return { topics, shift: Number(metadata.get("time_shift_s")) };
}

function protobufDecoder(schema) {
    const root = protobuf.Root.fromDescriptor(descriptor.FileDescriptorSet.decode(schema.data));
    const type = root.lookupType(schema.name);
    return (data) => type.toObject(type.decode(data), { longs: Number, defaults: true });
}

function rosDecoder(schema) {
    const reader = new serialization.MessageReader(rosmsg.parse(Buffer.from(schema.data).toString(), { ros2: true }));
    return (data) => reader.readMessage(data);
}

/** Columns of a ply: x y z intensity ring time instance. */
function readPly(name) {
    const bytes = fs.readFileSync(path.join(folder, name));
    const end = bytes.indexOf("end_header\n") + 11;
    const header = bytes.subarray(0, end).toString("latin1").split("\n");
    const sizes = { float: 4, int: 4, ushort: 2, uint16: 2, uchar: 1, uint8: 1 };
    const properties = header.filter((l) => l.startsWith("property ")).map((l) => l.split(" ").slice(1));
    const count = Number(header.find((l) => l.startsWith("element vertex")).split(" ")[2]);
    const rows = [];
    for (let i = 0, at = end; i < count; ++i) {
        const row = {};
        for (const [type, field] of properties) {
            row[field] = type === "float" ? bytes.readFloatLE(at) : type === "int" ? bytes.readInt32LE(at)
                       : sizes[type] === 2 ? bytes.readUInt16LE(at) : bytes.readUInt8(at);
            at += sizes[type];
        }
        rows.push(row);
    }
    return rows;
}

/** Points as ply has them, from the fields that a message describes. @param widths by the number of a type */
function unpack(data, stride, fields, readers) {
    const bytes = Buffer.from(data);
    const rows = [];
    for (let at = 0; at + stride <= bytes.length; at += stride) {
        const row = {};
        for (const field of fields) row[field.name] = readers[field.type](bytes, at + field.offset);
        rows.push(row);
    }
    return rows;
}

const kFoxglove = { 1: (b, i) => b.readUInt8(i), 3: (b, i) => b.readUInt16LE(i), 6: (b, i) => b.readInt32LE(i), 7: (b, i) => b.readFloatLE(i) };
const kRos = { 2: (b, i) => b.readUInt8(i), 4: (b, i) => b.readUInt16LE(i), 6: (b, i) => b.readUInt32LE(i), 7: (b, i) => b.readFloatLE(i) };

function same(what, found, expected, names) {
    check(`${what}: ${found.length} points, expected ${expected.length}, more than 10`,
          found.length === expected.length && expected.length > 10);
    const wrong = found.filter((row, i) => names.some((name) => row[name] !== expected[i]?.[name]));
    check(`${what}: ${wrong.length} points differ`, wrong.length === 0);
}

function near(what, found, expected, tolerance) {
    check(`${what}: ${found}, expected ${expected}`, found.every((x, i) => Math.abs(x - expected[i]) <= tolerance));
}

const xyz = (v) => [v.x, v.y, v.z];
const place = (scan) => scan.world_from_sensor.slice(0, 3).map((row) => row[3]);

function checkFoxglove({ topics, shift }, scans) {
    check(`scans.mcap: topics ${Object.keys(topics)}`, ["/tf", "/lidar/points", "/actors"].every((t) => topics[t]?.length === scans.length));
    scans.forEach((scan, i) => {
        const cloud = topics["/lidar/points"][i].value;
        const ply = readPly(scan.files.find((f) => f.endsWith(".ply")));
        near("time of a cloud", [cloud.timestamp.seconds + 1e-9 * cloud.timestamp.nanos], [scan.time_s + shift], 1e-6);
        const fields = cloud.fields.map((f) => ({ ...f, offset: Number(f.offset) }));
        same("foxglove.PointCloud", unpack(cloud.data, cloud.point_stride, fields, kFoxglove), ply,
             ["x", "y", "z", "intensity", "ring", "time", "instance"]);
        near("foxglove.FrameTransform", xyz(topics["/tf"][i].value.translation), place(scan), 1e-9);
        const boxes = topics["/actors"][i].value;
        check("foxglove.SceneUpdate: no deletion of all", boxes.deletions[0]?.type === 1);
        check(`foxglove.SceneUpdate: ${boxes.entities.length} boxes, expected one at least`, boxes.entities.length >= 1);
        for (const box of boxes.entities) check("a box without a size", box.cubes[0].size.x > 0.5 && box.arrows.length === 0);
    });
}

function checkRos({ topics, shift }, scans) {
    const plain = topics["/lidar/points"], autoware = topics["/lidar/points_xyzircaedt"];
    check(`rosbag.mcap: topics ${Object.keys(topics)}`, [plain, autoware, topics["/tf"]].every((t) => t?.length === scans.length));
    scans.forEach((scan, i) => {
        const ply = readPly(scan.files.find((f) => f.endsWith(".ply")));
        const points = (message) => unpack(message.data, message.point_step, message.fields.map((f) => ({ ...f, type: f.datatype })), kRos);
        const cloud = plain[i].value, stamp = cloud.header.stamp;
        same("PointCloud2", points(cloud), ply, ["x", "y", "z", "intensity"]);
        check("PointCloud2: width, row_step, is_dense",
              cloud.width === ply.length && cloud.row_step === ply.length * cloud.point_step && cloud.is_dense === true);
        const rows = points(autoware[i].value);
        same("XYZIRCAEDT", rows, ply, ["x", "y", "z"]);
        const start = stamp.sec + 1e-9 * (stamp.nsec ?? stamp.nanosec) - shift;
        const off = rows.filter((row, k) => {
            const p = ply[k];
            const range = Math.hypot(p.x, p.y, p.z);
            const good = row.channel === p.ring && row.return_type === 3 && Math.abs(row.intensity - 255 * p.intensity) <= 0.51 &&
                         Math.abs(row.distance - range) <= 1e-4 && Math.abs(row.azimuth - Math.atan2(p.y, p.x)) <= 1e-5 &&
                         Math.abs(row.elevation - Math.asin(p.z / range)) <= 1e-5 &&
                         Math.abs(start + 1e-9 * row.time_stamp - (scan.time_s + p.time)) <= 1e-6;
            return !good;
        });
        check(`XYZIRCAEDT: ${off.length} points have another ring, return, angle, distance or time`, off.length === 0);
        const transform = topics["/tf"][i].value.transforms[0];
        check(`TFMessage: ${transform.header.frame_id} ${transform.child_frame_id}`,
              transform.header.frame_id === "world" && transform.child_frame_id === cloud.header.frame_id);
        near("TFMessage, within a sweep's way", xyz(transform.transform.translation), place(scan), 2.0);
    });
}

(async () => {
    const { scans } = JSON.parse(fs.readFileSync(path.join(folder, "scans.json")));
    checkFoxglove(await read("scans.mcap", protobufDecoder), scans);
    checkRos(await read("rosbag.mcap", rosDecoder), scans);
    if (failures.length) console.log(failures.join("\n"));
    process.exit(failures.length ? 1 : 0);
})();
