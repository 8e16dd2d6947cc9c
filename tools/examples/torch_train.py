#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Trains a scene with Adam of PyTorch, and nearly the losses and learning rates of the preset `quick`.
`relidar refine RUN` then trains the network that corrects ray drops.

    PYTHONPATH=build/ci/tools/python python3 tools/examples/torch_train.py LOG RUN [ITERATIONS [FRAMES]]
"""
import copy
import sys

import torch
import torch.nn.functional as F

import relidar


def draw_batch(frame, n_rays):
    """Returns a Frame with about n_rays rays, in groups of four neighbouring columns."""
    rows, columns = frame.shape
    stride = max(1, rows * columns // n_rays)
    chosen = torch.arange(columns // 4 * 4).view(-1, 4)[torch.randint(stride, ())::stride].flatten()
    batch = copy.copy(frame)
    batch.shape = rows, len(chosen)
    for name in ("rays", "range", "intensity", "weight"):
        setattr(batch, name, getattr(frame, name).reshape(rows, columns, -1)[:, chosen].flatten(0, 1).squeeze(1))
    return batch


def compute_loss(out, batch):
    known, hit = batch.weight > 0, (batch.weight > 0) & (batch.range > 0)
    error = (out["range"][hit] - batch.range[hit]).abs()
    # The logarithm ignores outliers. It replaces the loss `likelihood`, which needs the hits of a ray.
    return (0.1 * error.mean() + 0.02 * torch.log1p(error / 0.05).mean()
            + 0.3 / 0.2 * F.huber_loss(out["intensity"][hit], batch.intensity[hit], delta=0.2)
            + 0.1 * (1 - out["weight"][hit]).square().mean()
            + 0.01 * F.binary_cross_entropy_with_logits(out["drop_logits"][known], (~hit[known]).float()))


def list_rates(scene):
    """Returns a list of (name of a parameter, part of it, learning rate)."""
    extent = 6 * (scene.means - scene.means.mean(0)).norm(dim=1).quantile(0.9).item()
    rates = [("means", ..., 1e-5 * extent), ("quats", ..., 5e-3), ("log_scales", ..., 6.5e-2), ("opacity_logits", ..., 0.15)]
    for channels, rate in ((slice(0, 1), 0.04), (slice(1, 3), 0.08)):   # intensity; hit logit and drop logit
        rates += [("features", (slice(None), channels, 0), rate), ("features", (slice(None), channels, slice(1, 4)), 0.05 * rate)]
    return rates


def train(run, log, iterations, n_rays=24576):
    """Returns the run with trained surfels."""
    scene = relidar.torch.Scene.from_run(run)
    frames = [relidar.torch.Frame(run, log, i).to(scene.device) for i in range(len(log)) if i not in run.held_out]
    rates = list_rates(scene)
    views = [getattr(scene, name).detach()[part] for name, part, _ in rates]   # Adam changes the memory of the scene
    optimiser = torch.optim.Adam([{"params": [view], "lr": rate} for view, (_, _, rate) in zip(views, rates)])
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.05 ** (1 / iterations))
    largest = scene.log_scales.detach().amax(1, keepdim=True) + 2.08   # log(8)
    for _ in range(iterations):
        batch = draw_batch(frames[torch.randint(len(frames), ())], n_rays)
        loss = compute_loss(relidar.torch.render(scene, batch), batch)
        gradients = dict(zip(scene.named_parameters(), torch.autograd.grad(loss, scene.parameters())))
        for view, (name, part, _) in zip(views, rates):
            view.grad = gradients[name][part]
        optimiser.step()
        schedule.step()
        torch.minimum(scene.log_scales.data, largest, out=scene.log_scales.data)
    return run.with_surfels(scene.surfels())


def main(log_folder, run_folder, iterations="540", n_frames="-1"):
    # The training of one iteration aligns the scans, and makes surfels and actors from their points.
    config = relidar.Config("quick", {"train.iterations": 1, "dataset.frames_end": int(n_frames)})
    log = relidar.load_sequence(log_folder, config)
    run = train(relidar.train(log, config), log, int(iterations))
    run.save(run_folder, overwrite=True)
    print(relidar.evaluate(run, log)["mean"] if run.held_out else "no frame is held out")


if __name__ == "__main__":
    main(*sys.argv[1:])
