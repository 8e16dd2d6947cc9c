# SPDX-License-Identifier: Apache-2.0
"""tools/bench/paper_tables: the commands that it prints, the tables that it makes of scores, and that relidar accepts
its commands.

   paper_tables_test.py SOURCE_FOLDER RELIDAR WORK_FOLDER

The scores come from a stand-in for relidar, so that the expected cells are known.
"""
import os
import shutil
import subprocess
import sys
import unittest
from pathlib import Path

SOURCE, RELIDAR, WORK = (Path(word).resolve() for word in sys.argv[1:4])

# Writes scores, fails, or is interrupted, depending on the part; records each call.
STAND_IN = """#!/usr/bin/env python3
import json, os, sys
from pathlib import Path
with open("calls.txt", "a") as calls:
    print(*sys.argv[1:], file=calls)
assert "--resume" in sys.argv
out, part = Path(sys.argv[sys.argv.index("--out") + 1]), sys.argv[sys.argv.index("--sequence") + 1]
if part == "kd3":
    print("relidar: note: not the reason", file=sys.stderr)
    sys.exit(print("relidar: no scan of kd3", file=sys.stderr) or 3)
if part == "kd4":
    sys.exit(130)
out.mkdir(parents=True, exist_ok=True)
rmse = {"kd1": 3.0, "kd2": 4.0}.get(part, 5.0)
scores = {"mean": {"peer/depth_rmse_m": rmse, "strict/depth_rmse_m": 9.0}, "timings": {"trace_ms": 25.0}, "peak_device_bytes": 2e9,
          "frames": [{}] * 4}
(out / "metrics.json").write_text(json.dumps(scores))
(out / "scene.json").write_text(json.dumps({"counts": {"frames": 50, "boxes": 0 if part == "kd2" else 3}}))
"""


def call(*words, program="stand_in"):
    command = [sys.executable, "-B", str(SOURCE / "tools/bench/paper_tables"), "--out", "out", "--relidar", str(program), *words]
    return subprocess.run(command, capture_output=True, text=True)


class PaperTables(unittest.TestCase):
    def setUp(self):
        shutil.rmtree(WORK, ignore_errors=True)
        WORK.mkdir(parents=True)
        os.chdir(WORK)
        Path("stand_in").write_text(STAND_IN)
        os.chmod("stand_in", 0o755)
        os.environ["PATH"] = f"{WORK}:{os.environ['PATH']}"

    def test_dry_run_prints_the_commands(self):
        done = call("--kitti360", "K", "--waymo", "W", "--parts", "kd1,ws1", "--set", "train.iterations=9", "--dry-run")
        self.assertEqual(done.stdout.splitlines(), [
            "stand_in train kitti360:K --sequence kd1 --out out/kd1-paper --preset paper --set sensor.grid=kitti360 "
            "--set train.grid=kitti360 --set sensor.grid_method=cast --set train.iterations=9 --resume",
            "stand_in train waymo:W --sequence ws1 --out out/ws1-paper --preset paper --set train.iterations=9 --resume"])
        # all parts of both datasets
        self.assertEqual(len(call("--kitti360", "K", "--waymo", "W", "--dry-run").stdout.splitlines()), 18)
        self.assertFalse(Path("out").exists() or Path("calls.txt").exists())

    def test_tables_have_the_scores(self):
        done = call("--kitti360", "K", "--parts", "kd1,kd2,kd3", "--preset", "quick")
        self.assertEqual(done.returncode, 3)   # kd2 has no labels, and kd3 has no scans
        columns = "40 | 2 | {} | – | – | – | – | – | – | – | – | – | – | – |"
        for expected in ["| LiDAR-RT, as printed | 10 | 42.7 | 0.41 | 3.4671 | 0.0512 | 0.1016 | 0.8406 | 27.6755 | 0.1115 |",
                         "| relidar, `quick` | 2 of 10 | " + columns.format("3.5000"),
                         "| kd1-quick | done | " + columns.format("3.0000"),
                         "| kd2-quick | done, but the log has no labelled boxes | " + columns.format("4.0000"),
                         "| kd3-quick | failed with exit code 3: no scan of kd3 | – |"]:
            self.assertIn(expected, done.stdout)
        self.assertRegex(done.stderr, "2 of 3 rows .*kd2-quick")
        self.assertEqual(call("--kitti360", "K", "--parts", "kd1").returncode, 0)

    def test_stops_where_it_is_interrupted(self):
        done = call("--kitti360", "K", "--parts", "kd4,kd5")
        self.assertEqual(done.returncode, 130)
        self.assertIn("| kd4-paper | interrupted |", done.stdout)
        self.assertIn("| kd5-paper | not trained |", done.stdout)
        self.assertEqual(len(Path("calls.txt").read_text().splitlines()), 1)

    def test_bad_options(self):
        for words, message in [(["--kitti360", "K", "--parts", "kd1,kd7"], "kd7"), ([], "found no dataset"),
                               (["--kitti360", "K", "--relidar", "none"], "program none")]:
            done = call(*words)
            self.assertEqual(done.returncode, 2)
            self.assertIn(message, done.stderr)

    def test_relidar_accepts_the_commands(self):
        train, *others = call("--kitti360", "K", "--parts", "kd1", "--ablation", "--dry-run").stdout.splitlines()
        (evaluate,) = [command for command in others if " eval " in command]
        for command in (train, evaluate):
            done = subprocess.run([RELIDAR, *command.split()[1:]], capture_output=True, text=True)
            self.assertIn(done.returncode, (3, 4), done.stderr)   # 3: the folder does not exist; 4: no device
        settings = [word for command in [train, *others] for word in command.split() if "=" in word]
        self.assertIn("refine.rays=none", settings)
        done = subprocess.run([RELIDAR, "list", "settings", *(word for s in settings for word in ("--set", s))], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)


unittest.main(argv=sys.argv[:1])
