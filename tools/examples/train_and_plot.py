#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Trains a scene on the demo's street, renders scans from a new pose, and plots them. Cells start with
`# %%`.

    PYTHONPATH=build/ci/tools/python tools/examples/train_and_plot.py [FOLDER [ITERATIONS]]
"""
# %% Input and output paths
import pathlib
import sys

import numpy as np

import relidar

folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "train_and_plot")
iterations = int(sys.argv[2]) if len(sys.argv) > 2 else 300
print("device:", relidar.Device().info.name)

# %% A log: the synthetic street that `relidar demo` trains on; the path of a KITTI drive
# also works
relidar.save_street(folder / "street", n_frames=12)
config = relidar.Config("quick", {"train.iterations": iterations, "train.log_every": max(1, iterations // 6), "init.scale_factor": 0.6})
log = relidar.load_log(folder / "street", config)
print(f"{log.name}: {len(log)} frames, boxes {', '.join(log.boxes)}")

# %% Training, with a progress line from time to time
def show(line):
    print(f"iteration {line.iteration}/{line.n_iterations}  loss {line.loss:.4f}  {line.n_surfels} surfels")


run = relidar.train(log, config, callback=show)
run.save(folder / "run", overwrite=True)

# %% Scores of the held-out frames
scores = relidar.evaluate(run, log)["mean"]
for metric in ("strict/depth_medae_m", "strict/depth_rmse_m", "strict/drop_accuracy"):
    print(metric, round(scores[metric], 4))

# %% A scan from 2 m to the left and 1 m up, with a car removed
position = run.held_out[0]
times, poses = run.trajectory
track = next(iter(run.actors))
scan = run.edit().remove(track).run().render(time=times[position], pose=poses[position] @ relidar.pose(0, 2, 1))

# %% Pictures: range, intensity and drop probability of the real and of the simulated scan
relidar.write_picture(folder / "real.png", log.scan(position))
relidar.write_picture(folder / "simulated.png", scan)

# %% Points, and a view from above if matplotlib is installed
returned = (scan["drop_prob"] < 0.5) & (scan["median_range"] > 0)
points = scan["points"][returned]
np.save(folder / "points.npy", points)
print(f"{len(points)} points, the farthest {np.linalg.norm(points, axis=1).max():.1f} m away")
try:
    import matplotlib.pyplot as plt
except ImportError:
    print("matplotlib is not installed, so no view from above is drawn")
else:
    plt.scatter(points[:, 0], points[:, 1], s=1, c=points[:, 2], cmap="turbo")
    plt.axis("equal")
    plt.xlabel("forward, m")
    plt.ylabel("left, m")
    plt.savefig(folder / "above.png", dpi=150)
