# SPDX-License-Identifier: Apache-2.0
"""Tests tools/lpips_weights on files of both formats of torch.save. The test writes the files from
the description of the formats: pickles that refer to torch's functions, and separate storages.
relidar must read the values that were written.

    lpips_weights_test.py SOURCE_DIR RELIDAR WORK_FOLDER
"""
import collections
import json
import os
import pathlib
import pickle
import random
import shutil
import struct
import subprocess
import sys
import types
import zipfile
from names import names

SHAPES = [(64, 3, 11), (192, 64, 5), (384, 192, 3), (256, 384, 3), (256, 256, 3)]

torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")


def _rebuild_tensor_v2(*_):
    pass


class FloatStorage:
    pass


_rebuild_tensor_v2.__module__, FloatStorage.__module__ = "torch._utils", "torch"
utils._rebuild_tensor_v2, torch.FloatStorage, torch._utils = _rebuild_tensor_v2, FloatStorage, utils
sys.modules |= {"torch": torch, "torch._utils": utils}


class Storage:
    def __init__(self, key, data):
        self.key, self.data = key, data


class Tensor:
    """Tensor that is pickled like a tensor of torch: a call that rebuilds the tensor from a
    separate storage."""

    def __init__(self, storage, offset, shape):
        self.storage, self.offset, self.shape = storage, offset, shape

    def __reduce__(self):
        strides, n = [], 1
        for extent in reversed(self.shape):
            strides.insert(0, n)
            n *= extent
        return _rebuild_tensor_v2, (self.storage, self.offset, tuple(self.shape), tuple(strides), False, collections.OrderedDict())


class Writer(pickle.Pickler):
    legacy = False

    def persistent_id(self, what):
        if isinstance(what, Storage):
            return ("storage", FloatStorage, what.key, "cpu", len(what.data) // 4) + ((None,) if self.legacy else ())
        return None


def write_zip(path, tensors):
    with zipfile.ZipFile(path, "w") as archive:
        with archive.open("archive/data.pkl", "w") as file:
            Writer(file, 2).dump(tensors)
        for tensor in tensors.values():
            archive.writestr(f"archive/data/{tensor.storage.key}", tensor.storage.data)
        archive.writestr("archive/version", "3\n")


def write_legacy(path, tensors):
    with open(path, "wb") as file:
        for head in (0x1950A86A20F9469CFC6C, 1001, {"protocol_version": 1001, "little_endian": True, "type_sizes": {}}):
            pickle.dump(head, file, 2)
        writer = Writer(file, 2)
        writer.legacy = True
        writer.dump(tensors)
        pickle.dump([t.storage.key for t in tensors.values()], file, 2)
        for tensor in tensors.values():
            file.write(struct.pack("<q", len(tensor.storage.data) // 4) + tensor.storage.data)


def floats(n, seed):
    draw = random.Random(seed)
    return struct.pack(f"<{n}f", *(draw.uniform(-1, 1) for _ in range(n)))


def main():
    source, relidar, work = pathlib.Path(sys.argv[1]), sys.argv[2], pathlib.Path(sys.argv[3])
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    backbone, heads, truth = collections.OrderedDict(), collections.OrderedDict(), {}

    def add(tensors, name, ours, shape):
        n, before = 1, 3 * (len(tensors) == 0)   # the first tensor starts within its storage
        for extent in shape:
            n *= extent
        data = floats(before + n, ours)
        tensors[name] = Tensor(Storage(str(len(tensors)), data), before, shape)
        truth[ours] = (list(shape), data[4 * before:])

    for i, (out, into, edge) in enumerate(SHAPES):
        add(backbone, f"features.{[0, 3, 6, 8, 10][i]}.weight", f"conv{i}.weight", (out, into, edge, edge))
        add(backbone, f"features.{[0, 3, 6, 8, 10][i]}.bias", f"conv{i}.bias", (out,))
        add(heads, f"lin{i}.model.1.weight", f"lin{i}.weight", (1, out, 1, 1))
    write_zip(work / "new.pth", backbone)
    write_legacy(work / "old.pth", backbone)
    write_legacy(work / "heads.pth", heads)

    def convert(*names):
        return subprocess.run([source / "tools/lpips_weights", *(str(work / name) for name in names)], capture_output=True, text=True)

    for backbone_file in ("new.pth", "old.pth"):
        done = convert(backbone_file, "heads.pth", "out.safetensors")
        assert done.returncode == 0, done.stderr
        data = (work / "out.safetensors").read_bytes()
        n = struct.unpack("<Q", data[:8])[0]
        header = json.loads(data[8:8 + n])
        assert set(header) == set(truth)
        for name, (shape, numbers) in truth.items():
            begin, end = header[name]["data_offsets"]
            assert header[name]["shape"] == shape and data[8 + n + begin:8 + n + end] == numbers, name
        (work / "street.toml").write_text("seed = 1\nn_frames = 3\nrows = 32\ncolumns = 64\n")
        read = subprocess.run([relidar, "eval", f"synthetic:{work}", "--baseline", "nearest", "--set", "dataset.test_frames=1"],
                              capture_output=True, text=True, env=os.environ | {"RELIDAR_LPIPS_WEIGHTS": str(work / "out.safetensors")})
        assert read.returncode == 0 and "peer/depth_lpips" in read.stdout and "no weights" not in read.stdout, read
        (work / "out.safetensors").unlink()

    def refused(message, *files):
        done = convert(*files, "out.safetensors")
        assert done.returncode == 3 and done.stderr.count("\n") == 1 and names(done.stderr, message), (message, done.stderr)
        assert not (work / "out.safetensors").exists()

    refused("heads.pth ... features.0.weight", "heads.pth", "heads.pth")
    refused("No such file", "nowhere.pth", "heads.pth")
    (work / "cut.pth").write_bytes((work / "old.pth").read_bytes()[:5000])
    refused("cut.pth: ", "cut.pth", "heads.pth")
    (work / "text.pth").write_text("weights")
    refused("text.pth ... torch.save", "text.pth", "heads.pth")
    with open(work / "evil.pth", "wb") as file:
        pickle.dump(subprocess.run, file)
    refused("evil.pth ... subprocess.run", "evil.pth", "heads.pth")
    backbone["features.3.weight"] = Tensor(Storage("99", floats(128 * 64 * 9, "vgg")), 0, (128, 64, 3, 3))
    write_zip(work / "vgg.pth", backbone)
    refused("features.3.weight ... [128, 64, 3, 3] ... [192, 64, 5, 5]", "vgg.pth", "heads.pth")
    print("lpips_weights: all checks passed")


main()
