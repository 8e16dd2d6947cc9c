# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for libraries that are not installed, so that the data code of OpenPCDet, mmdet3d and the
nuScenes development kit runs from its own sources. Only what this code needs for records and points works."""
import importlib
import importlib.abc
import importlib.machinery
import pathlib
import pickle
import sys
import types

import numpy as np

LIBRARIES = {"SharedArray", "cachetools", "cv2", "descartes", "easydict", "fire", "kornia", "matplotlib", "mmcv", "mmdet",
             "mmengine", "motmetrics", "numba", "pandas", "pycocotools", "skimage", "sklearn", "spconv", "terminaltables",
             "torchvision", "tqdm"}
COMPILED = "pcdet.ops.roiaware_pool3d.roiaware_pool3d_cuda", "pcdet.ops.iou3d_nms.iou3d_nms_cuda"


class _Meta(type):
    def __getattr__(cls, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything


class Anything(metaclass=_Meta):
    """Can be a base class, a decorator, a function or a module; returns itself."""

    def __new__(cls, *arguments, **_):
        if cls is Anything and len(arguments) == 1 and callable(arguments[0]):
            return arguments[0]   # it decorates
        return super().__new__(cls)

    def __init__(self, *_, **__):
        pass

    def __call__(self, *arguments, **_):
        return arguments[0] if len(arguments) == 1 and callable(arguments[0]) else self

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything()


class Attributes(dict):
    """A dict of which entries are attributes, like easydict.EasyDict."""

    def __init__(self, entries):
        super().__init__({key: Attributes(value) if isinstance(value, dict) else
                          [Attributes(v) if isinstance(v, dict) else v for v in value] if isinstance(value, list) else value
                          for key, value in entries.items()})

    __getattr__ = dict.__getitem__


class _Progress:
    def __init__(self, rows=(), **_):
        self.rows = rows

    def __iter__(self):
        return iter(self.rows)

    def update(self, *_):
        pass

    close = update


def _dump(value, path, *_):
    pathlib.Path(path).write_bytes(pickle.dumps(value))


def _read_image(path):
    from PIL import Image
    return np.asarray(Image.open(path))


def _check_file(path):
    if not pathlib.Path(path).is_file():
        raise FileNotFoundError(path)


def _points_in_boxes(boxes, points, indices):
    for row, box in enumerate(boxes.numpy()):
        indices[row] = __import__("torch").from_numpy(inside_box(points.numpy(), box))


FUNCTIONS = {
    "easydict": {"EasyDict": Attributes},
    "tqdm": {"tqdm": _Progress},
    "skimage.io": {"imread": _read_image},
    "mmengine": {"track_iter_progress": iter, "dump": _dump, "load": lambda path: pickle.loads(pathlib.Path(path).read_bytes()),
                 "is_filepath": lambda path: isinstance(path, (str, pathlib.Path)), "check_file_exist": _check_file},
    "mmengine.fileio": {"get": lambda path, **_: pathlib.Path(path).read_bytes()},
    "cachetools": {"cached": lambda *_, **__: lambda function: function},
    COMPILED[0]: {"points_in_boxes_cpu": _points_in_boxes},
}


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name, path, target=None):
        is_known = name.split(".")[0] in LIBRARIES or name in COMPILED
        return importlib.machinery.ModuleSpec(name, self, is_package=True) if is_known else None

    def create_module(self, spec):
        module = types.ModuleType(spec.name)
        module.__path__ = []
        # `from skimage import io` asks for an attribute before it imports a module.
        module.__getattr__ = lambda name: (importlib.import_module(f"{spec.name}.{name}") if f"{spec.name}.{name}" in FUNCTIONS
                                           else getattr(Anything, name))
        return module

    def exec_module(self, module):
        vars(module).update(FUNCTIONS.get(module.__name__, {}))


def install():
    sys.meta_path.append(_Finder())   # last, so that installed libraries precede


def open_package(name, folder):
    """Makes a package without running its __init__.py, which would import all of its models."""
    module = types.ModuleType(name)
    module.__path__ = [str(folder)]
    sys.modules[name] = module
    return module


def inside_box(points, box):
    """Returns which points are in a box: x, y, z of the centre, length, width, height, yaw."""
    x, y, z = (points[:, :3] - box[:3]).T
    c, s = np.cos(box[6]), np.sin(box[6])
    return (np.abs(c * x + s * y) <= box[3] / 2) & (np.abs(c * y - s * x) <= box[4] / 2) & (np.abs(z) <= box[5] / 2)
