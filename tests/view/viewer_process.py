# SPDX-License-Identifier: Apache-2.0
"""Helpers for tests of `relidar view`: a run of a small street, and the program that serves it."""
import shutil
import signal
import subprocess

STREET = "seed = 3\nn_frames = 6\nrows = 32\ncolumns = 512\n"
TRAIN = ["--preset", "quick", "--set", "train.refine_poses=none", "--set", "train.iterations=3", "--set", "dataset.test_every=3",
         "--set", "init.actor_min_points=10", "--set", "refine.enabled=false", "--no-eval", "--quiet"]
PATIENCE_S = 60


def train_street(relidar, work):
    """Trains a run in work/run for a few iterations."""
    shutil.rmtree(work, ignore_errors=True)
    (work / "street").mkdir(parents=True)
    (work / "street/street.toml").write_text(STREET)
    subprocess.run([relidar, "train", "street", "--out", "run", *TRAIN], cwd=work, check=True)


class Viewer:
    """A process of `relidar view` with the given arguments."""

    def __init__(self, relidar, work, *arguments):
        command = [relidar, "view", *arguments, "--save-to", "saved", "--quiet"]
        self.process = subprocess.Popen(command, cwd=work, stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().strip()

    def end(self):
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(timeout=PATIENCE_S) == 0, self.process.returncode   # a busy tab may delay the end of the viewer

    def kill(self):
        self.process.kill()
