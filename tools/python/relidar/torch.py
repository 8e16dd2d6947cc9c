# SPDX-License-Identifier: Apache-2.0
"""Renders LiDAR rays as a function of PyTorch, with gradients of surfels, poses and rays.

The parameters of a Scene are tensors in the memory of the renderer, so that optimisers change them in
place. Nothing is copied through the host if relidar and PyTorch use the same device. Otherwise tensors
are copies on the host. docs/python.md is the guide.
"""
import contextlib
import copy
import math
import threading
import warnings

import numpy as np

import relidar
from relidar.scan_dataset import ScanDataset  # noqa: F401

try:
    import torch
    from torch.autograd.function import once_differentiable
except ModuleNotFoundError as error:
    if error.name != "torch":
        raise
    raise ModuleNotFoundError("relidar.torch needs PyTorch, which is not installed; see https://pytorch.org", name="torch") from None

_BLENDED = ("depth", "weight", "intensity", "hit_logit", "drop_logit", "likelihood")   # values with gradients
_OTHER = ("transmittance", "median_depth", "hits", "instance")
# Name of a parameter here -> name in relidar.Scene.
_STORED = {"means": "mean", "quats": "rotation", "log_scales": "log_scale", "opacity_logits": "opacity_logit",
           "features": "sh", "log_scales_w": "log_scale_w", "gait": "gait"}
# Name of an argument of render() -> the parameter that it replaces, and how.
_ACTIVATED = {"scales": ("log_scales", torch.log), "opacities": ("opacity_logits", lambda o: torch.logit(o, 1e-6))}
_UNKNOWN_TIME = 3e38
_MAX_LENGTH_ERROR = 1e-3   # of directions; float16 rounds by less
# With training=True, the boxes of surfels in the ray-tracing tree are larger by this factor and by this length
# in metres, as in relidar.train(). 90 % of the factor is for growing scales, the remainder for growing opacities.
_MARGIN = 1.05, 0.003
_MAX_GROWTH = {"log_scales": 0.9 * math.log(_MARGIN[0]), "log_scales_w": 0.9 * math.log(_MARGIN[0]), "opacity_logits": 0.3}
_MAX_TURN = 0.005   # change of each number of a quaternion of length 1; together at most an angle of 0.02 radians


def _tensor(values):
    """Returns a tensor of the same memory as an array or an object with __dlpack__."""
    if torch.is_tensor(values):
        return values
    if not hasattr(values, "__dlpack__"):
        raise relidar.DataError(f"found an object of type {type(values).__name__}, expected a tensor")
    return torch.from_numpy(values) if isinstance(values, np.ndarray) else torch.from_dlpack(values)


def _check(name, values, shape, dtypes=(torch.float32,), device=None):
    """Returns a tensor. Raises DataError if its shape (-1: any length), dtype or device is wrong."""
    tensor = _tensor(values)
    matches = len(shape) == tensor.dim() and all(e in (-1, n) for e, n in zip(shape, tensor.shape))
    if not matches or tensor.dtype not in dtypes or device not in (None, tensor.device):
        expected = " or ".join(str(d)[6:] for d in dtypes) + f" {list(shape)}" + (f" on {device}" if device else "")
        raise relidar.DataError(f"{name}: found {str(tensor.dtype)[6:]} {list(tensor.shape)} on {tensor.device}, "
                                f"expected {expected} (-1: any)")
    return tensor


def _check_rays(rays):
    """Raises DataError for rays that are not finite, or whose directions do not have length 1."""
    values = rays.detach()
    lengths = values[:, 3:6].norm(dim=1)
    wrong = torch.nonzero(~(values.isfinite().all(1) & ((lengths - 1).abs() < _MAX_LENGTH_ERROR)))
    if len(wrong):
        ray = int(wrong[0])
        raise relidar.DataError(f"rays: ray {ray} is {values[ray].tolist()} with a direction of length {float(lengths[ray]):.6g}, "
                                "expected finite numbers and length 1")


def _is_shared(array):
    """Returns True if PyTorch can use the memory of a DeviceArray."""
    return array.is_shared and (array.__dlpack_device__()[0] == 1 or torch.cuda.is_available())


def _read(array):
    """Returns a tensor of the memory of a DeviceArray, or a copy."""
    return torch.from_dlpack(array) if _is_shared(array) else torch.from_numpy(array.numpy())


def _write(array, values):
    """Replaces the values of a DeviceArray, without the host if both use the same device."""
    if not _is_shared(array):
        return array.copy_from(values.detach().cpu().contiguous())
    target = torch.from_dlpack(array)
    target.copy_(values.detach())
    if target.is_cuda:   # relidar does not wait for PyTorch
        torch.cuda.current_stream(target.device).synchronize()


def _hat(w):
    """Returns [...,3,3] matrices of the cross product with [...,3] vectors."""
    x, y, z = w.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*w.shape, 3)


def move(poses, motion):
    """Moves rigid poses: dL/d(motion) is defined at 0, so optimise a motion that starts at 0.

    poses: [...,4,4]
    motion: [...,6], shift in metres along the axes of the world, and rotation vector in radians about
        the origin of the pose
    """
    turned = torch.linalg.matrix_exp(_hat(motion[..., 3:])) @ poses[..., :3, :3]
    shifted = poses[..., :3, 3:] + motion[..., :3, None]
    return torch.cat([torch.cat([turned, shifted], -1), poses[..., 3:, :]], -2)


def _pose_gradient(poses, motion, centre=0.0):
    """Converts dL/d(motion) about a centre to dL/d(poses) within the space of rigid poses.

    poses: [...,4,4]; motion: [...,6]; centre: [...,3], relative to the origin of each pose
    """
    shift, turn = motion[..., :3], motion[..., 3:]
    turn = turn + torch.cross(torch.zeros_like(turn) + centre, shift, dim=-1)
    rotation = 0.5 * _hat(turn) @ poses[..., :3, :3]
    return torch.nn.functional.pad(torch.cat([rotation, shift[..., None]], -1), (0, 0, 0, 1))


class Frame:
    """A scan of a log, as training uses it, for render().

    rays: [n,7] tensor of origins, directions and times; range (metres, 0: dropped), intensity and weight
    (0: ignored): [n] tensors; shape: (rows, columns); view_origin: position of the sensor, [3] array
    """

    def __init__(self, run, log, position):
        """run: gives poses and actors; log: its log; position: of the frame in run.times"""
        arrays = run.training_rays(log, position)
        self.run, self.position, self.shape, self.view_origin = run, position, arrays["shape"], arrays["view_origin"]
        self.rays = torch.from_numpy(arrays["rays"])
        self.range, self.intensity, self.weight = torch.from_numpy(arrays["measured"]).unbind(1)

    def _change(self, change):
        for name in ("rays", "range", "intensity", "weight"):
            setattr(self, name, change(getattr(self, name)))
        return self

    def to(self, device):
        """Copies the tensors to the device of a scene. Returns the frame."""
        return self._change(lambda tensor: tensor.to(device))

    def select(self, rays, columns=None):
        """Returns a frame with some of the rays.

        rays: [n] indices, on the device of the frame; columns: number of columns if they form an image in row order
        """
        part = copy.copy(self)
        part.shape = (len(rays) // columns, columns) if columns else (1, len(rays))
        return part._change(lambda tensor: tensor[rays])


class Scene:
    """Surfels whose parameters are tensors that an optimiser changes in place.

    means [s,3]; quats [s,4] (w x y z, need not have length 1); log_scales [s,2]; opacity_logits [s];
    features [s,3,16]: SH coefficients of intensity, hit logit and drop logit. 3D Gaussians also have
    log_scales_w [s], walking actors gait [s,5]. instances: index of each instance by its track, or "background".
    """

    def __init__(self, scene, config=None, *, poses=False, rays=False, training=False, device=None):
        """scene: relidar.Scene, is copied; config, device: see relidar.DifferentiableRenderer
        poses, rays: if True, render() also computes gradients of poses, or of rays
        training: if True, works as relidar.train() does, which is faster: gradients of parameters are sparse
            tensors, with a row for each surfel that a ray hit, for the optimiser Adam of this module. The
            ray-tracing tree is updated only after a scale has grown by 4 %, a centre has moved by 3 mm, a surfel
            has turned by 1 degree, or an opacity logit has grown by 0.3. In between, rays may miss the faint
            edge of a surfel
        """
        self.renderer = relidar.DifferentiableRenderer(scene, config, poses=poses, rays=rays, sparse=training,
                                                       margin=_MARGIN if training else None, device=device)
        self._n_instances, self._computes = len(scene.instances), {"poses": poses, "rays": rays}
        self.instances = {instance["track"] or "background": i for i, instance in enumerate(scene.instances)}
        self._training, self._fitted = training, None   # parameters at the last update of the tree
        arrays = self.renderer.device_parameters()
        self._arrays = {name: arrays[stored] for name, stored in _STORED.items() if stored in arrays}
        self._memory = {name: _read(array) for name, array in self._arrays.items()}
        for name, memory in self._memory.items():
            setattr(self, name, memory.data.requires_grad_())
        if not _is_shared(arrays["mean"]):
            warnings.warn(f"tensors of {self.renderer.device.info.name} are copies through the host, because PyTorch cannot use its memory")
        self._n_renders = 0
        self._lock = threading.Lock()   # a batch needs several calls of the renderer

    @classmethod
    def from_run(cls, run, **options):
        """Returns the scene of a run with the run's settings. options: those of Scene()"""
        return cls(run.scene, run.config, **options)

    def named_parameters(self):
        """Returns the parameters by name, for example for an optimiser with a rate for each."""
        return {name: getattr(self, name) for name in self._arrays}

    def parameters(self):
        return list(self.named_parameters().values())

    @property
    def device(self):
        """The device of all tensors."""
        return self.means.device

    @property
    def scales(self):
        return self.log_scales.exp()

    @property
    def opacities(self):
        return self.opacity_logits.sigmoid()

    def surfels(self):
        """Returns a copy of the parameters as numpy arrays for relidar.Scene and Run.with_surfels()."""
        return {_STORED[name]: values.detach().cpu().numpy().copy() for name, values in self.named_parameters().items()}

    @contextlib.contextmanager
    def _replace(self, values):
        """Replaces the parameters in the memory of the renderer for a while."""
        kept = {}
        for (name, memory), value in zip(self._memory.items(), values):
            if value.data_ptr() != memory.data_ptr() or value.stride() != memory.stride():
                kept[name] = memory.clone()
                memory.copy_(value)
        try:
            yield
        finally:
            for name, own in kept.items():
                self._memory[name].copy_(own)

    def _is_refit_due(self):
        """Returns True if surfels may have outgrown their boxes in the ray-tracing tree."""
        if self._fitted is None:
            return True
        changes = {name: self._memory[name] - old for name, old in self._fitted.items()}
        moved, turned = changes.pop("means").abs().max(), changes.pop("quats").abs().max() / self._shortest_quat
        # A comparison with NaN is False, so that NaN leads to an update.
        return not (moved < _MARGIN[1] and turned < _MAX_TURN
                    and all(change.max() < _MAX_GROWTH[name] for name, change in changes.items()))

    def _place(self, request, view, poses):
        """Places the instances, and updates the tree if this is necessary."""
        refit = self._is_refit_due()
        if request.frame and poses is None and request.present is None:
            self.renderer.place_frame(request.frame.run, request.frame.position, view, refit=refit)
        else:
            placed = np.tile(np.eye(4), (self._n_instances, 1, 1)) if poses is None else poses.double().cpu().contiguous().numpy()
            present = [True] * self._n_instances if request.present is None else request.present
            self.renderer.place(placed, view, present, refit=refit)
        if refit and self._training:
            self._fitted = {name: memory.clone() for name, memory in self._memory.items() if name in ("means", "quats", *_MAX_GROWTH)}
            self._shortest_quat = self._memory["quats"].norm(dim=1).min()

    def _render(self, request, rays, sensor, poses, values):
        """Renders a batch and returns copies of the rendered values."""
        self._n_renders += 1   # first, because an error also leaves other rays
        origins, directions, time = rays[:, :3], rays[:, 3:6], rays[:, 6:]
        if sensor is not None:
            turn, shift = sensor[:3, :3].to(rays), sensor[:3, 3].to(rays)
            origins, directions = origins @ turn.T + shift, directions @ turn.T
        if time.shape[1] == 0:
            time = torch.full_like(rays[:, :1], _UNKNOWN_TIME)
        view = request.view_origin(rays, sensor)
        with self._replace(values):
            for array, memory in zip(self._arrays.values(), self._memory.values()):
                if not _is_shared(array):
                    _write(array, memory)
            _write(self.renderer.device_rays(len(rays)), torch.cat([origins, directions, time], 1))
            if request.measured is not None:
                ones = torch.ones_like(request.measured)   # the second column is not used
                _write(self.renderer.device_measured(len(rays)), torch.stack([request.measured, ones, ones], 1))
            self._place(request, view, poses)
            rendered = self.renderer.forward_device(len(rays), request.columns, request.measured is not None)
        self._d_rendered = rendered["d_rendered"]
        return tuple(_read(rendered[name]).clone() for name in _BLENDED + _OTHER)

    def _backpropagate(self, values, d_rendered):
        """Returns DeviceArrays of the gradients of the last batch."""
        upstream = torch.zeros(self._d_rendered.shape, dtype=torch.float32, device=self.device)
        for column, gradient in zip(upstream.unbind(1), d_rendered):
            if gradient is not None:
                column.copy_(gradient)
        with self._replace(values):
            _write(self._d_rendered, upstream)
            return self.renderer.backward_device()

    def _gradients(self, arrays, values, needed):
        """Yields the gradient of each parameter, or None."""
        rows = torch.nonzero(_read(arrays["touched"])).T if self._training else None
        for name, value, is_needed in zip(self._arrays, values, needed):
            gradient = _read(arrays[_STORED[name]]) if is_needed else None
            if gradient is None or rows is None:
                yield gradient if gradient is None else gradient.clone()
                continue
            sparse = torch.sparse_coo_tensor(rows, gradient.index_select(0, rows[0]), gradient.shape)
            yield sparse if value.is_leaf else sparse.to_dense()


class _Request:
    """Arguments of a batch that have no gradient."""

    def __init__(self, frame, present, columns, measured):
        self.frame, self.present, self.columns, self.measured = frame, present, columns, measured

    def view_origin(self, rays, sensor):
        """Returns the position of the sensor, from which SH directions start, [3] float64."""
        if sensor is None:
            return self.frame.view_origin if self.frame else rays[:, :3].mean(0).double().cpu().numpy()
        pose = sensor.double().cpu().numpy()
        if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-4) or not np.allclose(pose[3], [0, 0, 0, 1]):
            raise relidar.DataError("sensor: found a matrix that is not rigid, expected a rotation and a translation, with the last row 0 0 0 1")
        return pose[:3, 3] + (pose[:3, :3] @ self.frame.view_origin if self.frame else 0.0)


class _Render(torch.autograd.Function):
    """The kernels of relidar as a function of rays [n,6..7], poses and all parameters of a scene."""

    @staticmethod
    def forward(ctx, scene, request, rays, sensor, poses, *values):
        ctx.set_materialize_grads(False)
        ctx.scene, ctx.request = scene, request
        ctx.save_for_backward(rays, sensor, poses, *values)
        with scene._lock:
            rendered = scene._render(request, rays, sensor, poses, values)
            ctx.number = scene._n_renders
        ctx.mark_non_differentiable(*rendered[len(_BLENDED):])
        return rendered

    @staticmethod
    @once_differentiable
    def backward(ctx, *d_rendered):
        with ctx.scene._lock:
            return _Render._differentiate(ctx, d_rendered)

    @staticmethod
    def _differentiate(ctx, d_rendered):
        rays, sensor, poses, *values = ctx.saved_tensors
        scene, (needs_rays, needs_sensor, needs_poses) = ctx.scene, ctx.needs_input_grad[2:5]
        if scene._n_renders != ctx.number:   # another batch was rendered since
            scene._render(ctx.request, rays, sensor, poses, values)
            ctx.number = scene._n_renders
        arrays = scene._backpropagate(values, d_rendered)
        d_rays = d_sensor = d_poses = None
        if needs_rays:
            d_rays = torch.zeros_like(rays)
            d_rays[:, :6] = _read(arrays["rays"])
            if sensor is not None:
                d_rays[:, :6] = (d_rays[:, :6].reshape(-1, 2, 3) @ sensor[:3, :3].to(rays)).reshape(-1, 6)
        if needs_sensor:
            centre = sensor.new_tensor(ctx.request.view_origin(rays, sensor)) - sensor[:3, 3]
            d_sensor = _pose_gradient(sensor, _read(arrays["sensor"]).to(sensor), centre)
        if needs_poses:
            d_poses = _pose_gradient(poses, _read(arrays["poses"]).to(poses))
        return (None, None, d_rays, d_sensor, d_poses, *scene._gradients(arrays, values, ctx.needs_input_grad[5:]))


def _replace_parameters(scene, replacements):
    """Returns the tensors of all parameters, with the replacements of an argument of render()."""
    values = {name: _check(name, value, scene._memory[name].shape, device=scene.device) for name, value in scene.named_parameters().items()}
    for name, given in replacements.items():
        raw, inverse = _ACTIVATED.get(name, (name, None))
        if raw not in values:
            raise relidar.UsageError(f"render: found the parameter {name}, expected one of {', '.join([*values, *_ACTIVATED])}")
        tensor = _check(name, given, values[raw].shape, device=scene.device)
        values[raw] = inverse(tensor) if inverse else tensor
    return values.values()


def _empty_values(rays, parameters):
    """Returns the values of no rays. Their gradients are 0, for the rays and all parameters."""
    nothing = rays[:, 0] + sum(parameter.flatten()[:0].sum() for parameter in parameters)
    whole = torch.zeros(0, dtype=torch.int32, device=rays.device)
    return [nothing.clone() for _ in _BLENDED] + [nothing.detach(), nothing.detach(), whole, whole.clone()]


def _check_gradient(scene, name, tensor, option):
    if tensor is not None and tensor.requires_grad and torch.is_grad_enabled() and not scene._computes[option]:
        raise relidar.UsageError(f"render: {name} requires a gradient, which this scene does not compute; use Scene(..., {option}=True)")


class Adam(torch.optim.Optimizer):
    """Adam that changes only the rows that have a gradient, as relidar.train() with train.only_touched.
    Other rows keep their moments. It is made for the sparse gradients of Scene(training=True).

    params: as in torch.optim.Adam. A group can have `factors`, a tensor of the shape of a row that multiplies
        its rate, for example [3,16] for features. Columns with the factor 0 never change
    """

    def __init__(self, params, lr=1e-3, betas=(0.9, 0.999), eps=1e-15):
        super().__init__(params, {"lr": lr, "betas": betas, "eps": eps, "factors": None})

    @torch.no_grad()
    def step(self, closure=None):
        loss = closure and torch.enable_grad()(closure)()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self._step_rows(group, parameter, self.state[parameter])
        return loss

    @staticmethod
    def _step_rows(group, parameter, state):
        sparse = parameter.grad if parameter.grad.is_sparse else parameter.grad.to_sparse(1)
        if not (sparse._indices()[0].diff() > 0).all():   # gradients of several batches have equal rows
            sparse = sparse.coalesce()
        rows, gradient, factors = sparse._indices()[0], sparse._values(), group["factors"]
        if len(rows) == 0:
            return
        used = ...
        if factors is not None:
            factors = _check("factors", factors, parameter.shape[1:], (torch.float32, torch.float64))
            if not factors.any():
                return
            if factors.dim() > 0:   # leaves out the last columns if their factors are 0
                used = ..., slice(int(factors.reshape(-1, factors.shape[-1]).any(0).nonzero().max()) + 1)
            factors, gradient = factors[used].to(gradient), gradient[used]
        shape, gradient = gradient.shape, gradient.reshape(len(gradient), -1)
        if not state:
            state["step"], state["moments"] = 0, gradient.new_zeros(2, len(parameter), gradient.shape[1])
        state["step"] += 1
        moments = []
        for memory, power, beta in zip(state["moments"], (gradient, gradient.square()), group["betas"]):
            moment = memory.index_select(0, rows).lerp_(power, 1 - beta)
            memory.index_copy_(0, rows, moment)
            moments.append(moment.div_(1 - beta ** state["step"]))
        change = moments[0].div_(moments[1].sqrt_().add_(group["eps"])).reshape(shape)
        values = parameter.index_select(0, rows)
        values[used].sub_(change.mul_(group["lr"] * (1.0 if factors is None else factors)))
        parameter.index_copy_(0, rows, values)


def render(scene, rays, *, sensor=None, poses=None, present=None, columns=0, measured=None, **parameters):
    """Renders rays. Differentiable by parameters, rays, sensor and poses.

    scene: Scene
    rays: float32 [n,6] origins and directions (length 1), or [n,7] with times; n may be 0; or a pair of origins and
        directions [n,3]; or a Frame; or a list of these, a batch of scans. Metres, seconds
    sensor: [4,4] pose of the sensor in the scene; rays are in its frame. None: rays are in the scene's frame.
        With a Frame: a motion of its rays
    poses: [instances,4,4] poses of the instances (scene.instances) in the scene. None: all at the origin. With a
        Frame, they replace those of the frame, and no instance moves during the scan; None: as in the Frame
    present: one bool for each instance; with a Frame only together with poses. None: all are present
    columns: number of columns if the rays are an image in row order, which is faster on a GPU
    measured: [n] measured ranges (metres, 0: unknown), for `likelihood`. With a Frame: those of the frame
    parameters: tensors that replace those of the scene in this call: means, quats, features, scales and
        opacities, or log_scales and opacity_logits. Gradients flow to these tensors

    Returns a dict of [n] tensors: range and median_range (metres, 0: no hit), intensity, drop_logits (the
    sigmoid is the drop probability), and the values of relidar.DifferentiableRenderer.forward(). If
    loss.likelihood is above 0 in the settings of the scene, also likelihood (0 to 1), how well the hits explain
    the measured range: sum of w / (1 + (e / 0.05 m)^2) for weights w of the hits and their distances e to
    the measured range. For a list of rays, a list of dicts; then sensor, poses and measured have a value for
    each entry. Everything has gradients except transmittance, median_depth, hits and instance; a median
    range is constant if it is the distance of a single surfel.
    """
    if isinstance(rays, list):
        each = [[None] * len(rays) if value is None else value for value in (sensor, poses, measured)]
        if any(len(value) != len(rays) for value in each):
            raise relidar.DataError("render: found {} sensors, {} lists of poses and {} lists of ranges, expected {}, one for each scan".format(
                *map(len, each), len(rays)))
        return [render(scene, one, sensor=at, poses=placed, present=present, columns=columns, measured=ranges, **parameters)
                for one, at, placed, ranges in zip(rays, *each)]
    frame = rays if isinstance(rays, Frame) else None
    if frame and measured is None and scene.renderer.likelihood_scale_m > 0:
        measured = frame.range * (frame.weight > 0)
    if frame:
        if poses is None and present is not None:
            raise relidar.UsageError("render: found present with a Frame, which has its own poses; expected poses, too")
        rays, columns = frame.rays, frame.shape[1]
    elif isinstance(rays, tuple):
        if len(rays) != 2:
            raise relidar.DataError(f"rays: found a tuple of {len(rays)} values, expected origins and directions")
        origins = _check("origins", rays[0], (-1, 3), device=scene.device)
        rays = torch.cat([origins, _check("directions", rays[1], (len(origins), 3), device=scene.device)], 1)
    rays = _tensor(rays)
    rays = _check("rays", rays, (-1, 7 if rays.shape[-1:] == (7,) else 6), device=scene.device)
    _check_rays(rays)
    doubles = (torch.float32, torch.float64)
    sensor = None if sensor is None else _check("sensor", sensor, (4, 4), doubles)
    poses = None if poses is None else _check("poses", poses, (scene._n_instances, 4, 4), doubles)
    for name, tensor, option in (("rays", rays, "rays"), ("sensor", sensor, "poses"), ("poses", poses, "poses")):
        _check_gradient(scene, name, tensor, option)
    present = None if present is None else [bool(one) for one in present]
    measured = None if measured is None else _check("measured", measured, (len(rays),), device=scene.device).detach().clone()
    request, values = _Request(frame, present, columns, measured), _replace_parameters(scene, parameters)
    if len(rays) == 0:
        values = _empty_values(rays, values)
    else:
        values = _Render.apply(scene, request, rays, sensor, poses, *values)
    out = dict(zip(_BLENDED + _OTHER, values))
    if measured is None:
        del out["likelihood"]
    hit = out["weight"] > 0
    out["range"] = torch.where(hit, out["depth"] / torch.where(hit, out["weight"], 1.0), 0.0)
    out["median_range"] = torch.where(out["median_depth"] > 0, out["median_depth"], out["range"])
    out["drop_logits"] = out["drop_logit"] - out["hit_logit"]
    return out
