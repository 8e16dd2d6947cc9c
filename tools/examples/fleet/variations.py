#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Renders a data set of varied scenes from one run (docs/guide.md):
  tools/examples/fleet/variations.py run --out set --scenes 40 --sensor VLP-16 --layout kitti

Each scene removes, delays and copies actors, draws a weather and shifts the sensor. What was
drawn depends only on the seed and the scene; set/scenes.csv lists it. A copy without ground below
it, or inside an actor or the background, gets another place; set/done/SCENE lists these copies.
Unknown options go to `relidar render`. The same command continues an interrupted data set.
"""
import argparse
import csv
import json
import math
import os
import pathlib
import random
import re
import shutil
import signal
import subprocess
import sys
import time


MAX_SPEED_MPS = {"Pedestrian": 2, "Cyclist": 8}   # of copies; other classes: 14 m/s, 50 km/h
MAX_DRAWS = 20   # places for the copies of a scene that cannot be where they were drawn first


def call(*words):
    """Runs relidar, and ends this program with its exit code if it fails."""
    done = subprocess.run([options.relidar, *map(str, words)], stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(done.returncode)
    return done.stdout


def draw_place(generator, path):
    """Returns a place on the ground, 3 to 9 m beside the path of the vehicle, for --copy."""
    at = generator.choice(path)
    side_m, yaw = generator.choice([-1, 1]) * generator.uniform(3, 9), math.radians(float(at["yaw_deg"]))
    x, y = float(at["x"]) - side_m * math.sin(yaw), float(at["y"]) + side_m * math.cos(yaw)
    # An actor on the left comes towards the vehicle, as in right-hand traffic.
    yaw_deg = float(at["yaw_deg"]) + (180 if side_m > 0 else 0)
    return f"{x:.2f},{y:.2f},ground,{yaw_deg:.1f}"


def draw_weather(generator):
    """Half of the scenes are clear. Fog: visibility in metres; rain and snow: mm per hour."""
    if generator.random() < 0.5:
        return ""
    kind, least, most = generator.choice([("fog", 40, 300), ("rain", 2, 30), ("snow", 0.5, 5)])
    return f"{kind}={generator.uniform(least, most):.1f}"


def draw_scene(scene, actors, path):
    """Returns the columns of scenes.csv for a scene. A list is separated by spaces."""
    generator = random.Random(f"{options.seed}/{scene}")
    removed = [a for a in actors if generator.random() < 0.3]
    delays = [f"{a}={generator.uniform(-1.5, 1.5):.2f}" for a in actors
              if a not in removed and generator.random() < 0.5]
    copies = []
    for _ in range(generator.randint(0, 3) if actors else 0):
        actor = generator.choice(list(actors))
        speed_mps = generator.uniform(0, MAX_SPEED_MPS.get(actors[actor], 14))
        copies.append(f"{actor}@{draw_place(generator, path)}:{speed_mps:.1f}")
    offset = [generator.gauss(0, sigma) for sigma in (0.3, 0.5, 0.1, 2.0)]
    return {"scene": scene, "seed": generator.randrange(2**31), "remove": " ".join(removed), "retime": " ".join(delays),
            "copy": " ".join(copies), "weather": draw_weather(generator), "offset": ",".join(f"{v:.3f}" for v in offset),
            "render": " ".join([options.sensor, options.frames, options.layout or "", *render_options])}


def find_blocked(copies, report):
    """Returns the first copy that overlaps something, after the notes of `relidar edit`, or None."""
    names = re.findall("^copied .* as ([^ ,]+)", report, re.M)   # the first edits, in their order
    notes = re.findall(r"^note: the (?:background|boxes)\b.*", report, re.M)
    return next((copy for copy, name in zip(copies, names) if any(name in note.split() for note in notes)), None)


def edit_run(row, edited):
    """Edits the run. A copy that has no ground below it, or that overlaps something, gets another
    place; after MAX_DRAWS places in all, it is left out. Returns a line for each of these copies."""
    copies, lines = row["copy"].split(), []
    generator, n_draws = random.Random(f"{row['seed']}/places"), 0
    while True:
        # A copy comes before the removal of its model.
        edits = [("--copy", copies), ("--retime", row["retime"].split()), ("--remove", row["remove"].split())]
        words = [word for option, values in edits for value in values for word in (option, value)]
        if not words:
            return lines
        done = subprocess.run([options.relidar, "edit", options.run, "--out", edited, *words, "--force"],
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        no_ground = [copy for copy in copies if f"--copy {copy}" in done.stderr] if done.returncode else []
        if done.returncode and not no_ground:
            print(done.stderr, end="", file=sys.stderr)
            sys.exit(done.returncode)
        failed = no_ground[0] if no_ground else find_blocked(copies, done.stdout)
        if not failed:
            print(done.stderr, end="", file=sys.stderr)
            return lines
        n_draws += 1
        if n_draws < MAX_DRAWS:
            actor, speed = failed[:failed.rindex("@")], failed[failed.rindex(":"):]
            place = f"{actor}@{draw_place(generator, path)}{speed}"
            copies[copies.index(failed)] = place
            lines.append(f"moved: {failed} to {place}")
        else:
            copies.remove(failed)
            lines.append(f"left out: {failed}")


def render_scene(row, out):
    """Edits the run and renders the scene. A half-written scene of an earlier call is replaced.
    Returns the lines of edit_run()."""
    edited = out / "edited"
    shutil.rmtree(edited, ignore_errors=True)   # of an interrupted scene
    lines = edit_run(row, edited)
    weather = ["--weather", row["weather"]] if row["weather"] else []
    # With --layout, all scenes are sequences of one data set.
    layout = ["--layout", options.layout] if options.layout else []
    folder = out / ("data" if layout else f"{row['scene']:04d}")
    call("render", edited if edited.exists() else options.run, "--out", folder, "--sensor", options.sensor,
         "--frames", options.frames, "--sample", row["seed"], f"--offset={row['offset']}", *weather, *layout, "--boxes",
         "--force", "--quiet", *render_options)
    shutil.rmtree(edited, ignore_errors=True)
    return lines


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                 allow_abbrev=False)
parser.add_argument("run")
parser.add_argument("--out", required=True, type=pathlib.Path)
parser.add_argument("--scenes", type=int, default=10)
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--sensor", default="native")
parser.add_argument("--frames", default="all")
parser.add_argument("--layout")
parser.add_argument("--relidar", default=shutil.which("relidar") or "relidar")
signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends this program without a traceback
options, render_options = parser.parse_known_args()
if options.scenes < 1:
    parser.error(f"--scenes: found {options.scenes}, expected at least 1")

info = json.loads(call("info", options.run, "--json"))
actors = {box["id"]: box["class"] for box in info["log"]["boxes"] if box["surfels"]}   # track -> class
options.out.mkdir(parents=True, exist_ok=True)
call("export", options.run, "--out", options.out / "path.csv", "--quiet")
path = list(csv.DictReader((options.out / "path.csv").open()))
rows = [draw_scene(scene, actors, path) for scene in range(options.scenes)]

# Another seed, run or sensor would mix two data sets, so the table must not change.
table = options.out / "scenes.csv"
if table.exists():
    earlier = list(csv.DictReader(table.open()))
    if earlier != [{k: str(v) for k, v in row.items()} for row in rows][:len(earlier)]:
        sys.exit(f"variations.py: {table} has other scenes; found another run, seed, sensor or option, or fewer scenes, "
                 "expected the same or a new --out")
with open(f"{table}.part", "w", newline="") as file:
    writer = csv.DictWriter(file, rows[0].keys())
    writer.writeheader()
    writer.writerows(rows)
os.replace(f"{table}.part", table)

done = options.out / "done"
done.mkdir(exist_ok=True)
left, begin_s = [row for row in rows if not (done / f"{row['scene']:04d}").exists()], time.monotonic()
for count, row in enumerate(left, 1):
    lines = render_scene(row, options.out)
    (done / f"{row['scene']:04d}").write_text("".join(f"{line}\n" for line in lines))
    spent_s = time.monotonic() - begin_s
    print(f"scene {row['scene'] + 1} of {len(rows)}, {spent_s:.0f} s, {spent_s / count * (len(left) - count):.0f} s left", flush=True)
