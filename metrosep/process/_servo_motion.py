"""Private: the motion of a servo over time, the delay exact."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray

if TYPE_CHECKING:
    from metrosep.process.servo import Gains, ServoModel


_OVERFLOW = 1e12
"""A response that has grown this much has diverged; the rest is not computed."""


def march(
    model: ServoModel, gains: Gains, t: FloatArray, z: FloatArray, step: float, fine: int
) -> FloatArray:
    """Return actual minus command on the samples of the command."""
    from scipy.interpolate import CubicSpline

    h = step / fine
    spline = CubicSpline(t, z, bc_type="natural")
    times = t[0] + h * np.arange((z.size - 1) * fine + 1)
    motion = np.column_stack([np.asarray(spline(times, k)) for k in (0, 1, 2)])
    if model.delay > 0.0:
        return _march_late(model, gains, motion, h, fine)
    return _march_at_once(model, gains, motion, h, fine)


def _march_at_once(
    model: ServoModel, gains: Gains, motion: FloatArray, h: float, fine: int
) -> FloatArray:
    """Return the error without delay: state (x, v, integral), command linear between steps."""
    m, k = model.mass, gains
    state = np.array(
        [[0.0, 1.0, 0.0], [-k.kp / m, -(k.kd + model.damping) / m, k.ki / m], [-1.0, 0.0, 0.0]]
    )
    drive = np.array([[0.0, 0.0, 0.0], [k.kp / m, k.kd / m, k.feedforward / m], [1.0, 0.0, 0.0]])
    across, now, following = _first_order_hold(state, drive, h)
    pushes = motion[:-1] @ now.T + motion[1:] @ following.T
    (xx, xv, xi), (vx, vv, vi), (ix, iv, ii) = across.tolist()
    # plain numbers: three times three is too small for arrays
    x = v = w = 0.0
    path = [0.0]
    for px, pv, pw in pushes.tolist():
        x, v, w = (
            xx * x + xv * v + xi * w + px,
            vx * x + vv * v + vi * w + pv,
            ix * x + iv * v + ii * w + pw,
        )
        if abs(x) > _OVERFLOW:
            break
        path.append(x)
    error = np.full(motion.shape[0], np.inf)
    error[: len(path)] = np.array(path) - motion[: len(path), 0]
    return error[::fine].copy()


def _march_late(
    model: ServoModel, gains: Gains, motion: FloatArray, h: float, fine: int
) -> FloatArray:
    """Return the error with delay: the forces of a step lie in the past and are known."""
    state = np.array([[0.0, 1.0], [0.0, -model.damping / model.mass]])
    drive = np.array([[0.0], [1.0 / model.mass]])
    across, now, following = _first_order_hold(state, drive, h)
    (_, xv), (_, vv) = across.tolist()
    (xa,), (va,) = now.tolist()
    (xb,), (vb,) = following.tolist()
    whole = math.floor(model.delay / h * (1.0 + 1e-12))
    part = max(model.delay / h - whole, 0.0)
    forces = [0.0] * (whole + 1)  # at rest before the start; forces[i] acts at step i
    x = v = integral = before = 0.0
    error = np.full(motion.shape[0], np.inf)
    forward = gains.kd * motion[:, 1] + gains.feedforward * motion[:, 2]
    for i, (c, lead) in enumerate(zip(motion[:, 0].tolist(), forward.tolist(), strict=True)):
        e = c - x
        integral += 0.5 * h * (e + before) if i else 0.0
        before = e
        error[i] = -e
        if abs(e) > _OVERFLOW:
            break
        forces.append(gains.kp * e + gains.ki * integral - gains.kd * v + lead)
        # forces[j] was decided at step j - whole - 1
        last = i + whole + 1
        at = forces[last - whole] * (1.0 - part) + forces[last - whole - 1] * part
        then = forces[last - whole + 1] * (1.0 - part) + forces[last - whole] * part
        x, v = x + xv * v + xa * at + xb * then, vv * v + va * at + vb * then
    return error[::fine].copy()


def _first_order_hold(
    state: FloatArray, drive: FloatArray, h: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what carries state, input now and input at the end of a step to that end, exactly."""
    from scipy.linalg import expm

    n, k = drive.shape
    block = np.zeros((n + 2 * k, n + 2 * k))
    block[:n, :n], block[:n, n : n + k] = state, drive
    block[n : n + k, n + k :] = np.eye(k) / h
    full = expm(block * h)
    following = full[:n, n + k :]
    return full[:n, :n], full[:n, n : n + k] - following, following
