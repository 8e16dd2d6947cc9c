#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Finds where a LiDAR is mounted on its vehicle: changes its pose until the ranges that a run predicts
equal the measured ranges. The search starts 0.3 m and 3 degrees away from the mounting of the log, which has
one LiDAR.

    PYTHONPATH=build/ci/tools/python python3 tools/examples/torch_mounting.py RUN [ITERATIONS]
"""
import sys

import numpy as np
import torch

import relidar


def pose_error(found, truth):
    """Returns the distance in metres and the angle in degrees between two poses [4,4]."""
    sine = np.linalg.norm(found[:3, :3] - truth[:3, :3]) / np.sqrt(8)
    return float(np.linalg.norm(found[:3, 3] - truth[:3, 3])), float(np.degrees(2 * np.arcsin(min(sine, 1.0))))


def find_mounting(run, log, start, iterations=120, n_rays=6000, note=None):
    """Returns the mounting vehicle_from_sensor, [4,4], with which held-out scans fit to the run.

    start: first estimate of the mounting; n_rays: rays of an iteration; note: called with a line of text
    """
    scene = relidar.torch.Scene.from_run(run, poses=True)
    positions = run.held_out or list(range(len(log)))
    frames = [relidar.torch.Frame(run, log, position).to(scene.device) for position in positions]
    vehicles = torch.from_numpy(run.trajectory[1][positions])
    vehicles[:, :3, 3] -= torch.from_numpy(run.world_offset)
    # The rays of a Frame are in the scene, with the mounting of the log.
    to_sensor = torch.linalg.inv(vehicles @ torch.from_numpy(next(iter(run.mountings.values()))))
    usable = [((frame.range > 0) & (frame.weight > 0)).nonzero()[:, 0] for frame in frames]
    start = torch.from_numpy(start)
    shift, turn = (torch.zeros(3, dtype=torch.float64, requires_grad=True) for _ in range(2))
    optimiser = torch.optim.Adam([{"params": [shift], "lr": 0.03}, {"params": [turn], "lr": 0.005}], betas=(0.8, 0.95))
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.01 ** (1 / iterations))
    for step in range(iterations):
        which = step % len(frames)
        frame = frames[which].select(usable[which][torch.randint(len(usable[which]), (n_rays,))])
        pose = vehicles[which] @ relidar.torch.move(start, torch.cat([shift, turn])) @ to_sensor[which]
        out = relidar.torch.render(scene, frame, sensor=pose)
        error = (out["range"] - frame.range)[out["weight"] > 0.5]
        width = max(0.05, 0.02 ** (step / iterations))   # errors far above it, in metres, have no effect
        loss = torch.log1p((error / width).square()).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if note and step % 20 == 0:
            note(f"iteration {step}  loss {float(loss):.4f}")
    return relidar.torch.move(start, torch.cat([shift, turn])).detach().numpy()


def main(folder, iterations="120"):
    """Returns the errors of the first and of the last estimate, as pose_error() does."""
    run = relidar.Run.load(folder)
    log = relidar.load_log(run.config["dataset.path"], run.config)
    truth = next(iter(run.mountings.values()))
    start = truth @ relidar.pose(0.2, -0.2, 0.1, 2, 1.5, -1.66)
    found = find_mounting(run, log, start, int(iterations), note=print)
    errors = pose_error(start, truth), pose_error(found, truth)
    for name, (metres, degrees) in zip(("start", "found"), errors):
        print(f"{name}: {metres:.3f} m and {degrees:.3f} degrees from the mounting of the log")
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:])
