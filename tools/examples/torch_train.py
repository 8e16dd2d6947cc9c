#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Trains a scene in PyTorch, with the losses and learning rates of the preset `quick`.
`relidar refine RUN` then trains the network that corrects ray drops.

    PYTHONPATH=build/ci/tools/python python3 tools/examples/torch_train.py LOG RUN [ITERATIONS [FRAMES]]
"""
import sys

import torch
import torch.nn.functional as F

import relidar


def draw_batch(frame, n_rays):
    """Returns a Frame with about n_rays rays, in groups of four neighbouring columns."""
    rows, columns = frame.shape
    stride = max(1, rows * columns // n_rays)
    chosen = torch.arange(columns // 4 * 4).view(-1, 4)[torch.randint(stride, ())::stride].flatten()
    return frame.select((torch.arange(rows)[:, None] * columns + chosen).flatten(), len(chosen))


def compute_loss(out, batch):
    known, hit = batch.weight > 0, (batch.weight > 0) & (batch.range > 0)
    return (0.1 * (out["range"][hit] - batch.range[hit]).abs().mean()
            - 0.05 * torch.log(0.01 + 0.99 * out["likelihood"][hit]).mean()   # 1 % of the returns are outliers
            + 0.3 / 0.2 * F.huber_loss(out["intensity"][hit], batch.intensity[hit], delta=0.2)
            + 0.1 * (1 - out["weight"][hit]).square().mean()
            + 0.01 * F.binary_cross_entropy_with_logits(out["drop_logits"][known], (~hit[known]).float()))


def list_groups(scene):
    """Returns the groups of parameters with their learning rates, for an optimiser."""
    extent = 6 * (scene.means - scene.means.mean(0)).norm(dim=1).quantile(0.9).item()
    factors = torch.zeros(3, 16)   # of the rate of each SH coefficient; those above degree 1 stay constant
    factors[:, :4] = 0.05
    factors[:, 0] = 1
    factors[0] *= 0.5   # intensity; the others are the hit logit and the drop logit
    return [{"params": [scene.means], "lr": 1e-5 * extent}, {"params": [scene.quats], "lr": 5e-3},
            {"params": [scene.log_scales], "lr": 6.5e-2}, {"params": [scene.opacity_logits], "lr": 0.15},
            {"params": [scene.features], "lr": 0.08, "factors": factors}]


def train(run, log, iterations, n_rays=24576):
    """Returns the run with trained surfels."""
    scene = relidar.torch.Scene.from_run(run, training=True)
    frames = [relidar.torch.Frame(run, log, i).to(scene.device) for i in range(len(log)) if i not in run.held_out]
    optimiser = relidar.torch.Adam(list_groups(scene))
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.05 ** (1 / iterations))
    largest = scene.log_scales.detach().amax(1, keepdim=True) + 2.08   # log(8)
    for _ in range(iterations):
        batch = draw_batch(frames[torch.randint(len(frames), ())], n_rays)
        optimiser.zero_grad()
        compute_loss(relidar.torch.render(scene, batch), batch).backward()
        optimiser.step()
        schedule.step()
        torch.minimum(scene.log_scales.data, largest, out=scene.log_scales.data)
    return run.with_surfels(scene.surfels())


def main(log_folder, run_folder, iterations="540", n_frames="-1"):
    # The training of one iteration aligns the scans, and makes surfels and actors from their points.
    config = relidar.Config("quick", {"train.iterations": 1, "dataset.frames_end": int(n_frames)})
    log = relidar.load_log(log_folder, config)
    run = train(relidar.train(log, config), log, int(iterations))
    run.save(run_folder, overwrite=True)
    print(relidar.evaluate(run, log)["mean"] if run.held_out else "no frame is held out")


if __name__ == "__main__":
    main(*sys.argv[1:])
