# SPDX-License-Identifier: Apache-2.0
"""Simulated scans with labels as a map-style data set for torch.utils.data.DataLoader. Imports torch
only when a scan is made."""
import numpy as np

import relidar

_GROUND_M, _MARGIN_M = 0.15, 0.1   # a box begins above the ground, and ends this far outside of it
_MAX_EDITED_RUNS = 4   # edited runs that a process keeps on its device


class ScanDataset:
    """Simulated scans of a run with labels of actors and standing objects. Item i is the scan at
    poses[i % n] after edits[i // n], for n poses. Items with equal arguments are equal in every process.

    run: relidar.Run. It reaches the workers as a pickle, so save it first if it is large
    sensor: as in Run.render()
    poses: list of (time, pose) with a pose as in Run.render(); None: the scans of the log
    edits: list of edits. An edit is a list of calls of relidar.Edit, for example [("remove", "0"),
        ("move", "1", relidar.pose(0, 3, 0))]; an empty list is the run as it is
    classes: names of the classes; None: the classes of the actors of the run, sorted
    sample: seed; item i draws drops and noise with the seed sample + i. None: without noise
    min_points: boxes with fewer points are left out; their points have the instance -1
    render: further arguments of Run.render(), for example weather

    An item is a dict of tensors:
        points [n,4] float32: x, y, z, intensity, in the sensor frame at the time of the scan
        instance [n] int64: row of `boxes` that contains the point, or -1
        boxes [k,7] float32: x, y, z of the centre, length, width, height, yaw, in the same frame
        classes [k] int64: index in the attribute `classes`, or -1 for another class
        time [] float64: time of the scan in the log
    """

    def __init__(self, run, sensor=None, poses=None, edits=((),), *, classes=None, sample=None, min_points=1, **render):
        self.run, self.sensor, self.render = run, sensor, render
        self.poses = list(poses) if poses is not None else [(time, None) for time in run.times]
        if not all(isinstance(pair, (tuple, list)) and len(pair) == 2 for pair in self.poses):
            raise relidar.UsageError("poses: expected a list of pairs (time, pose), for example list(zip(*run.trajectory))")
        self.edits = [list(edit) for edit in edits]
        for call in (call for edit in self.edits for call in edit):
            if isinstance(call, str) or not hasattr(relidar.Edit, str(call[0])):
                raise relidar.UsageError(f"edits: found {call!r}, expected lists of calls of relidar.Edit, for example [(\"remove\", \"0\")]")
        self.classes = list(classes) if classes is not None else sorted(set(run.categories.values()))
        self.sample, self.min_points = sample, min_points
        self._edited = {}

    def __len__(self):
        return len(self.poses) * len(self.edits)

    def __getstate__(self):
        return {**self.__dict__, "_edited": {}}

    def _edited_run(self, number):
        """Returns the run after an edit. Keeps the runs that were used last."""
        run = self._edited.pop(number, None)
        if run is None:
            edit = self.run.edit()
            for name, *arguments in self.edits[number]:
                getattr(edit, name)(*arguments)
            run = edit.run() if self.edits[number] else self.run
        self._edited[number] = run
        while len(self._edited) > _MAX_EDITED_RUNS:
            self._edited.pop(next(iter(self._edited)))
        return run

    def __getitem__(self, index):
        import torch

        if not -len(self) <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}")
        edit, position = divmod(index % len(self), len(self.poses))
        time, pose = self.poses[position]
        seed = None if self.sample is None else self.sample + index % len(self)
        scan = self._edited_run(edit).render(
            self.sensor, pose=pose, time=time, sample=seed, deskew=True, boxes=True, **self.render)
        returned = (scan["drop_prob"] < 0.5) & (scan["median_range"] > 0)
        points = np.concatenate([scan["points"][returned], scan["intensity"][returned][:, None]], axis=1)
        labels = scan["boxes"]
        kept = np.flatnonzero(labels["points"] >= self.min_points)
        in_sensor = np.linalg.inv(scan["pose"]) @ labels["pose"][kept]
        yaw = np.arctan2(in_sensor[:, 1, 0], in_sensor[:, 0, 0])
        boxes = np.concatenate([in_sensor[:, :3, 3], labels["size_m"][kept], yaw[:, None]], axis=1)
        names = [str(name) for name in scan["instance_names"]]
        row_of = np.full(len(names) + 1, -1, np.int64)   # the last entry is for rays without a hit
        instance = scan["instance"][returned]
        is_static = labels["is_static"][kept] == 1
        for row in np.flatnonzero(~is_static):
            row_of[names.index(str(labels["track"][kept][row]))] = row
        row_of_point = row_of[instance]
        for row in np.flatnonzero(is_static):   # part of the background
            in_box = (points[:, :3] - in_sensor[row, :3, 3]) @ in_sensor[row, :3, :3]
            half = labels["size_m"][kept][row] / 2
            inside = np.all((in_box >= [*(-half[:2] - _MARGIN_M), _GROUND_M - half[2]]) & (in_box <= half + _MARGIN_M), axis=1)
            row_of_point[inside & (instance == 0)] = row
        number_of = {name: number for number, name in enumerate(self.classes)}
        classes = [number_of.get(str(name), -1) for name in labels["class"][kept]]
        return {
            "points": torch.from_numpy(np.ascontiguousarray(points, np.float32)),
            "instance": torch.from_numpy(row_of_point),
            "boxes": torch.from_numpy(boxes.astype(np.float32)),
            "classes": torch.tensor(classes, dtype=torch.int64),
            "time": torch.tensor(float(time), dtype=torch.float64),
        }

    @staticmethod
    def collate(items):
        """Returns a dict of lists, because scans have different numbers of points and boxes."""
        return {name: [item[name] for item in items] for name in items[0]}

    def loader(self, batch_size=1, num_workers=0, **options):
        """Returns a DataLoader of this data set with collate(). Workers are started with spawn,
        because a forked process cannot use a device of its parent, and stay alive.

        options: further arguments of torch.utils.data.DataLoader"""
        from torch.utils.data import DataLoader

        if batch_size is not None:
            options.setdefault("collate_fn", self.collate)
        if num_workers > 0:
            options.setdefault("multiprocessing_context", "spawn")
            options.setdefault("persistent_workers", True)
        return DataLoader(self, batch_size=batch_size, num_workers=num_workers, **options)
