# SPDX-License-Identifier: Apache-2.0
"""Calls the losses of relidar.train() that are Python functions."""
import numbers
import types

import relidar


def call_loss(loss, rendered, measured, rays, upstream, term, **facts):
    """Calls a loss with the arrays of a batch. Adds its gradients to upstream and its value to term.

    rendered, measured, rays: dicts of DeviceArray; upstream: DeviceArray [n,k], gradients in the order of
        `rendered`; term: DeviceArray [1]; facts: further attributes of the batch
    """
    try:
        import torch
        from relidar.torch import _is_shared as is_shared, _read as read
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        torch, is_shared, read = None, lambda array: array.is_shared, lambda array: array.numpy()
    values, measured, rays = ({name: read(array) for name, array in arrays.items()} for arrays in (rendered, measured, rays))
    d_rendered, total = read(upstream), read(term)
    gradients = dict(zip(values, d_rendered.T))
    if torch:
        for value in values.values():
            value.requires_grad_()
    result = loss(types.SimpleNamespace(rendered=values, gradients=gradients, measured=measured, rays=rays, **facts))
    if torch and torch.is_tensor(result):
        if not result.requires_grad or result.numel() != 1:
            raise relidar.UsageError(
                f"train: a loss returned a tensor of shape {tuple(result.shape)}, requires_grad={result.requires_grad}; expected one "
                "number that depends on batch.rendered, or a float after adding to batch.gradients")
        result.backward()
        for name, value in values.items():
            if value.grad is not None:
                gradients[name] += value.grad
        result = result.detach().reshape(1)
    elif not isinstance(result, numbers.Real):
        raise relidar.UsageError(f"train: a loss returned {type(result).__name__}, expected a torch tensor or a float")
    total += result
    if torch and total.is_cuda:
        torch.cuda.synchronize()
    for array, changed in ((upstream, d_rendered), (term, total)):
        if not is_shared(array):
            array.copy_from(changed)
