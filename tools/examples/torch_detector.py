#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Trains a small detector on simulated scans of a run, in which copies of the actors stand at random places.

    PYTHONPATH=build/ci/tools/python python3 tools/examples/torch_detector.py RUN [EDITS [EPOCHS]]
"""
import random
import sys

import torch
import torch.nn.functional as F

import relidar

CELLS, CELL_M, LOW_M = torch.tensor([[64, 64, 10], [0.8, 0.8, 0.4], [-25.6, -25.6, -2.5]])   # a grid of x, y, z


def encode_scan(scan):
    """Returns [10,64,64], 1 if a cell has a point; and [64,64], near 1 at the centre of a box, less around it."""
    cell = ((scan["points"][:, :3] - LOW_M) / CELL_M).floor()
    image = torch.zeros(64, 64, 10)
    image[cell[((cell >= 0) & (cell < CELLS)).all(1)].long().unbind(1)] = 1
    way = (torch.ones(64, 64).nonzero()[:, None] + 0.5) - (scan["boxes"][:, :2] - LOW_M[:2]) / CELL_M[:2]
    return image.permute(2, 0, 1), F.pad(torch.exp(-way.square().sum(-1)), (0, 1)).amax(1).view(64, 64)


def compute_loss(logit, target, labelled):
    """Focal loss: cells that are already right count less, and cells near a centre are not negative.
    labelled: 1 where all objects have a label, 0 where a cell without a label says nothing."""
    p, centre = logit.sigmoid(), target > 0.6
    loss = torch.where(centre, (1 - p) ** 2 * F.softplus(-logit), labelled * (1 - target) ** 4 * p**2 * F.softplus(logit))
    return loss.sum() / centre.sum().clamp(min=1)


def train_network(images, targets, labelled, n_epochs):
    """Trains a network on images [n,10,64,64], targets [n,64,64] and labelled cells. Returns it with the loss
    of each step."""
    layers, losses = [], []
    for n, reach in ((10, 1), (16, 1), (16, 2), (16, 4), (16, 1)):
        layers += [torch.nn.Conv2d(n, 16, 3, padding=reach, dilation=reach), torch.nn.BatchNorm2d(16), torch.nn.ReLU()]
    network = torch.nn.Sequential(*layers, torch.nn.Conv2d(16, 1, 1), torch.nn.Flatten(0, 1))
    network[-2].bias.data.fill_(-3)   # most cells have no centre
    batches = [batch for _ in range(n_epochs) for batch in torch.randperm(len(images)).split(4)]
    optimiser = torch.optim.Adam(network.parameters(), lr=5e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 5e-3, len(batches))
    for batch in batches:
        mirrored = [axis for axis in (-2, -1) if torch.rand(()) < 0.5]
        loss = compute_loss(network(images[batch].flip(mirrored)), *(part[batch].flip(mirrored) for part in (targets, labelled)))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        losses.append(loss.item())
    return network.eval(), losses


def find_objects(network, image):
    """Returns the centres of detected objects, [k,2] in metres, and the score of each cell, [64,64]."""
    with torch.no_grad():
        logit = network(image[None])
    peaks = ((logit > -0.5) & (logit == F.max_pool2d(logit, 5, 1, 2)))[0].nonzero() + 0.5
    return peaks * CELL_M[:2] + LOW_M[:2], logit[0].sigmoid()


def draw_edit(run, rng):
    """Returns an edit that copies each actor to three places near the path of the vehicle."""
    edit = []
    for track in 3 * list(run.actors):
        pose = rng.choice(list(run.trajectory[1])) @ relidar.pose(rng.uniform(-20, 20), rng.uniform(-8, 8), 0, rng.uniform(0, 360))
        pose[2, 3] = run.actors[track][1][0, 2, 3]   # the height of the actor
        edit.append(("copy", track, pose))
    return edit


def main(run_folder, n_edits="60", n_epochs="20"):
    """Returns the loss of each step, and recall and precision of centres in held-out edits, within 1 m."""
    run, rng, matches = relidar.Run.load(run_folder), random.Random(1), []
    edits, frames = [draw_edit(run, rng) for _ in range(int(n_edits))], [(time, None) for time in run.times[::4]]
    n_held_out = max(1, len(edits) // 6)
    held_out, trained = (relidar.torch.ScanDataset(run, None, frames, part, sample=1, min_points=10)
                         for part in (edits[:n_held_out], edits[n_held_out:]))
    images, targets = (torch.stack(part) for part in zip(*map(encode_scan, trained)))
    network, losses = train_network(images, targets, torch.ones_like(targets), int(n_epochs))
    for scan in held_out:
        centres, _ = find_objects(network, encode_scan(scan)[0])
        near = torch.cdist(centres, scan["boxes"][:, :2]) < 1
        matches.append((near.any(0), near.any(1)))
    recall, precision = (torch.cat(part).float().mean().item() for part in zip(*matches))
    print(f"{len(held_out)} held-out scans: recall {recall:.2f}, precision {precision:.2f}, last loss {losses[-1]:.3f}")
    return losses, recall, precision


if __name__ == "__main__":
    main(*sys.argv[1:])
