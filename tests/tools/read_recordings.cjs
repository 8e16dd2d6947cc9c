// SPDX-License-Identifier: Apache-2.0
// Reads scans.mcap and rosbag.mcap of a rendering like a player, message by message in
// the order of the file. Transforms the points of each cloud to the world with the
// transforms that were received before. Compares them with the ply files of the same
// scans rendered with --frame world. Compares boxes with the run's scene.json, and all
// other data with the ply files and scans.json next to the recording.
//
//   node read_recordings.cjs NODE_MODULES RUN FOLDER WORLD SUBFOLDER=TOPIC=FRAME ...
//
// The last argument is repeated for each sensor; SUBFOLDER is . for a single sensor.
// Prints all errors, and with SHOW in the environment also the error of each cloud. The
// exit code is 1 if there are errors, and 77 if a package is missing.
"use strict";
const fs = require("fs");
const path = require("path");
const { packages, read, nanoseconds, Frames, readPly, points, interpolate, rotate, conjugate, xyz } = require("./recordings.cjs");

const kTolerance_m = 1e-4;   // floats 100 m away have 8e-6; between two poses a reader is off by less than 3e-5
const [modules, run, folder, world, ...words] = process.argv.slice(2);
const npm = packages(modules);
const scene = JSON.parse(fs.readFileSync(path.join(run, "scene.json")));
const sensors = words.map((word) => {
    const [subfolder, topic, frame] = word.split("=");
    const of = (where) => ({ ...JSON.parse(fs.readFileSync(path.join(where, subfolder, "scans.json"))), folder: path.join(where, subfolder) });
    return { topic, frame, own: of(folder), world: of(world) };
});

const failures = [];
function check(what, good) {
    if (!good) failures.push(what);
}
const difference = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));

function plyOf(summary, i) {
    return readPly(path.join(summary.folder, summary.scans[i].files.find((f) => f.endsWith(".ply"))));
}

/** Returns a cloud of any kind as points with `seconds` relative to the stamp. */
function unpack(message) {
    const rows = points(message.value), stamp = nanoseconds(message.value.header?.stamp ?? message.value.timestamp);
    for (const row of rows) row.seconds = row.time ?? 1e-9 * row.time_stamp;
    return { rows, stamp, frame: message.value.header?.frame_id ?? message.value.frame_id };
}

/**
 * Returns the firing time of a ray. Without a rolling shutter all rays of a scan are
 * fired at its time, although the ply file contains times of the sensor.
 */
function firedAt(summary, row) {
    return summary.settings["sensor.rolling_shutter"] ? row.time : 0;
}

/** @param frames  heard so far */
function checkCloud(what, sensor, i, message, frames, shift) {
    const { rows, stamp, frame } = unpack(message);
    const { points: said, scans } = sensor.own, inWorld = said.frame === "world";
    const own = plyOf(sensor.own, i), there = plyOf(sensor.world, i);
    check(`${what}: ${rows.length} points, expected ${own.length}, more than 10`, rows.length === own.length && own.length > 10);
    check(`${what}: frame ${frame}`, frame === (!inWorld ? sensor.frame : sensor.own.world_offset_m ? "map" : "world"));
    const start = 1e-9 * Number(stamp) - shift - scans[i].time_s;
    check(`${what}: a point fired ${1e-9 * Number(stamp - message.time)} s after it was logged`,
          rows.every((row) => Number(message.time - stamp) * 1e-9 >= row.seconds - 1e-8 && row.seconds >= 0));
    const wrong = rows.filter((row, k) => (row.ring ?? row.channel) !== own[k].ring || Math.abs(start + row.seconds - firedAt(sensor.own, own[k])) > 1e-6 ||
                                          ("instance" in row && row.instance !== own[k].instance) ||
                                          Math.abs(row.intensity - (row.channel === undefined ? 1 : 255) * own[k].intensity) > 0.51 * (row.channel !== undefined));
    check(`${what}: ${wrong.length} points have another ring, time, instance or intensity`, wrong.length === 0);
    let largest = 0, sum = 0;
    rows.forEach((row, k) => {
        const time = said.deskewed ? stamp : stamp + BigInt(Math.round(1e9 * row.seconds));
        const off = difference(frames.toWorld(frame, time, xyz(row)), xyz(there[k]));
        largest = Math.max(largest, off), sum += off;
    });
    if (process.env.SHOW) console.log(what, largest);
    check(`${what}: composed with /tf ${sum / rows.length} m off the world's points in the mean, ${largest} m at most`, largest <= kTolerance_m);
    if (rows[0].channel !== undefined) checkAngles(what, rows);
    else checkChannels(what, rows, own, said.deskewed && !inWorld);
}

/**
 * Checks that the channels equal those of the ply file. Skips deskewed normals, because a
 * recording has them in the frame of its stamp.
 */
function checkChannels(what, rows, own, isOtherFrame) {
    const names = Object.keys(own[0]).filter((name) => !["x", "y", "z", "intensity", "ring", "time", "instance", "return"].includes(name));
    for (const name of names) {
        const isNormal = /^n[xyz]$/.test(name), field = isNormal ? `normal_${name[1]}` : name;
        check(`${what}: no channel ${field}`, field in rows[0]);
        if (!(isNormal && isOtherFrame)) check(`${what}: another ${field}`, rows.every((row, k) => Math.abs(row[field] - own[k][name]) < 1e-6));
    }
    if (names.includes("nx"))
        check(`${what}: normals of another length`, rows.every((row) => Math.abs(Math.hypot(row.normal_x, row.normal_y, row.normal_z) - 1) < 1e-4));
}

function checkAngles(what, rows) {
    const wrong = rows.filter((r) => {
        const range = Math.hypot(r.x, r.y, r.z);
        return r.return_type !== 3 || Math.abs(r.distance - range) > 1e-4 || Math.abs(r.azimuth - Math.atan2(r.y, r.x)) > 1e-5 ||
               Math.abs(r.elevation - Math.asin(r.z / range)) > 1e-5;
    });
    check(`${what}: ${wrong.length} points have another return, angle or distance`, wrong.length === 0);
}

/** Returns the boxes of an actors' message of any kind by id, with pose and size. */
function boxesOf({ value }) {
    const pose = (p) => ({ t: xyz(p.position), q: [...xyz(p.orientation), p.orientation.w] });
    if (value.entities)
        return { stamp: nanoseconds(value.deletions[0].timestamp),
                 boxes: value.entities.map((e) => ({ id: e.id, time: nanoseconds(e.timestamp), pose: pose(e.cubes[0].pose), size: xyz(e.cubes[0].size), category: e.metadata[0].value })) };
    const stamp = nanoseconds(value.header.stamp);
    if (value.detections)
        return { stamp, boxes: value.detections.map((d) => ({ id: d.id, time: nanoseconds(d.header.stamp), pose: pose(d.bbox.center), size: xyz(d.bbox.size), category: d.results[0].hypothesis.class_id })) };
    return { stamp, boxes: value.objects.map((o) => ({
        id: Buffer.from(o.object_id.uuid).toString("hex"), label: o.classification[0].label, size: xyz(o.shape.dimensions),
        pose: pose(o.kinematics.pose_with_covariance.pose), velocity: xyz(o.kinematics.twist_with_covariance.twist.linear) })) };
}

/**
 * Returns the pose of a box of scene.json at a time of the log, and its velocity in its
 * own axes.
 */
function boxAt(box, seconds) {
    const last = box.time_s.length - 2;
    const i = Math.min(last, Math.max(0, box.time_s.findLastIndex((t) => t <= seconds)));
    const [a, b] = [i, i + 1].map((k) => box.world_from_box[k]).map(([x, y, z, qw, qx, qy, qz]) => ({ t: [x, y, z], q: [qx, qy, qz, qw] }));
    const dt = box.time_s[i + 1] - box.time_s[i], { t, q } = interpolate(a, b, (seconds - box.time_s[i]) / dt);
    return { q, t: t.map((x, k) => x + scene.world_offset_m[k]), velocity: rotate(conjugate(q), b.t.map((x, k) => (x - a.t[k]) / dt)) };
}

/** @param tracked  Autoware's message of the same stamp, in the same order */
function checkBoxes(what, message, tracked, shift) {
    const { stamp, boxes } = boxesOf(message), moving = boxesOf(tracked);
    check(`${what}: stamps differ`, moving.stamp === stamp);
    check(`${what}: ${boxes.length} boxes, expected ${scene.boxes.length}`, boxes.length === scene.boxes.length && moving.boxes.length === boxes.length);
    boxes.forEach((box, i) => {
        const truth = scene.boxes.find((known) => known.id === box.id), { label, velocity } = moving.boxes[i];
        check(`${what}: box ${box.id} is of ${Number(box.time - stamp) * 1e-9} s after the stamp`, box.time >= stamp && box.time <= message.time);
        for (const { pose, size, time } of [box, moving.boxes[i]]) {
            const there = boxAt(truth, 1e-9 * Number(time ?? stamp) - shift);
            const off = difference(pose.t, there.t), cosine = Math.abs(pose.q.reduce((sum, x, k) => sum + x * there.q[k], 0));
            check(`${what}: box ${box.id} is ${off} m and ${Math.acos(Math.min(1, cosine))} rad off`, off < 1e-5 && cosine > 1 - 1e-9);
            check(`${what}: box ${box.id} has size ${size}`, difference(size, truth.size_m) < 1e-9);
        }
        check(`${what}: ${box.category} has label ${label}`, box.category === truth.category && label === ({ Car: 1, Van: 1, Cyclist: 6, Pedestrian: 7 }[truth.category] ?? 0));
        const there = boxAt(truth, 1e-9 * Number(stamp) - shift);
        check(`${what}: box ${box.id} at ${velocity} m/s, expected ${there.velocity}`, difference(velocity, there.velocity) < 1e-3);
    });
}

/**
 * Returns the velocity between two transforms of one sweep, or nothing if their times are
 * too close.
 */
function wayBetween(a, b) {
    const [from, to] = [a, b].map((message) => message?.value.transforms[0]);
    const seconds = from && to ? 1e-9 * Number(nanoseconds(to.header.stamp) - nanoseconds(from.header.stamp)) : 0;
    if (seconds < 0.009 || seconds > 0.011) return undefined;
    return xyz(to.transform.translation).map((x, k) => (x - xyz(from.transform.translation)[k]) / seconds);
}

function checkMotion(file) {
    const poses = file.messages.filter((m) => m.topic === "/tf"), odometry = file.messages.filter((m) => m.topic === "/odom");
    check(`/odom: ${odometry.length} messages for ${poses.length} of /tf`, odometry.length === poses.length);
    odometry.forEach(({ value: o }, i) => {
        const tf = poses[i].value.transforms[0];
        check("/odom: frames", o.header.frame_id === "world" && o.child_frame_id === "base_link" && tf.child_frame_id === "base_link");
        check("/odom: not the pose of /tf", nanoseconds(o.header.stamp) === nanoseconds(tf.header.stamp) &&
              difference(xyz(o.pose.pose.position), xyz(tf.transform.translation)) === 0);
        const [before, after] = [wayBetween(poses[i - 1], poses[i]), wayBetween(poses[i], poses[i + 1])];
        if (!before || !after) return;
        const q = o.pose.pose.orientation, mean = before.map((v, k) => 0.5 * (v + after[k]));
        const off = difference(xyz(o.twist.twist.linear), rotate(conjugate([...xyz(q), q.w]), mean));
        check(`/odom: a velocity ${off} m/s off the way to its neighbours`, off < 0.05);
    });
    const clock = file.messages.filter((m) => m.topic === "/clock");
    check("/clock: not the time of the log", clock.length > 0 && clock.every((m) => nanoseconds(m.value.clock) === m.time));
}

function checkServiceQuality(file) {
    for (const [topic, channel] of Object.entries(file.channels)) {
        const profile = channel.metadata.get("offered_qos_profiles") ?? "";
        check(`${topic}: quality of service "${profile}"`, /^- history: 1\n  depth: \d+\n  reliability: 1\n/.test(profile) &&
              profile.includes(`\n  durability: ${topic === "/tf_static" ? 1 : 2}\n`));
    }
    check("no record of rosbag2, by which it takes numbers for policies", file.records.rosbag2?.get("serialized_metadata") === "");
}

/**
 * Returns the mounting of the log's LiDAR combined with the pose of the sensor on it from
 * scans.json.
 */
function checkMounting(what, frame, offset, found) {
    const [x, y, z, ...wxyz] = (scene.lidars.find((lidar) => lidar.name === frame) ?? scene.lidars[0]).vehicle_from_sensor;
    const q = [...wxyz.slice(1), wxyz[0]];
    for (const point of [[0, 0, 0], [1, 0, 0], [0, 1, 0]]) {
        const onLidar = [0, 1, 2].map((row) => offset[row][3] + point.reduce((sum, v, k) => sum + offset[row][k] * v, 0));
        const expected = rotate(q, onLidar).map((v, k) => v + [x, y, z][k]), there = rotate(found.q, point).map((v, k) => v + found.t[k]);
        check(`${what} is mounted ${difference(there, expected)} m off`, difference(there, expected) < 1e-6);
    }
}

function checkFile(file) {
    const frames = new Frames(), heard = {};
    let last = 0n;
    for (const message of file.messages) {
        check(`${file.name}: ${message.topic} logged at ${message.time} after ${last}`, message.time >= last);
        last = message.time;
        const i = heard[message.topic] = (heard[message.topic] ?? -1) + 1;
        if (message.topic.startsWith("/tf")) frames.hear(message);
        const sensor = sensors.find((s) => message.topic === s.topic || message.topic === s.topic + "_xyzircaedt");
        if (sensor) checkCloud(`${file.name} ${message.topic} ${i}`, sensor, i, message, frames, file.shift);
    }
    for (const { topic, own, frame } of sensors) {
        const inWorld = own.points.frame === "world", isRos = file.name === "rosbag.mcap";
        for (const [name, n] of [[topic, own.scans.length], [topic + "_xyzircaedt", isRos && !inWorld ? own.scans.length : 0]])
            check(`${file.name}: ${(heard[name] ?? -1) + 1} messages on ${name}, expected ${n}`, (heard[name] ?? -1) + 1 === n);
        const mounted = frames.of.get(frame);
        check(`${file.name}: base_link -> ${frame} is not on /tf_static`, mounted?.parent === "base_link" && mounted.isStatic);
        if (mounted) checkMounting(`${file.name}: ${frame}`, frame, own.sensor_offset, mounted.poses[0]);
    }
}

(async () => {
    const players = await read(npm, path.join(folder, "scans.mcap"), check), bag = await read(npm, path.join(folder, "rosbag.mcap"), check);
    for (const file of [players, bag]) checkFile(file);
    checkMotion(bag);
    checkServiceQuality(bag);
    const of = (file, topic) => file.messages.filter((m) => m.topic === topic);
    const tracked = of(bag, "/actors_autoware");
    for (const file of [players, bag]) {
        check(`${file.name}: ${of(file, "/actors").length} messages of actors`, of(file, "/actors").length === tracked.length && tracked.length > 0);
        of(file, "/actors").forEach((m, i) => checkBoxes(`${file.name} /actors ${i}`, m, tracked[i], file.shift));
    }
    if (failures.length) console.log([...failures.slice(0, 20), ...(failures.length > 20 ? [`and ${failures.length - 20} more`] : [])].join("\n"));
    process.exit(failures.length ? 1 : 0);
})().catch((error) => {
    console.log([...failures.slice(0, 20), error.message].join("\n"));
    process.exit(1);
});
