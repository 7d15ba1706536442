"""State feedback from the sensor of the load: a discrete linear-quadratic regulator (LQR).

The model is the nominal axis as an integrator with the swinging load behind it. The state consists
of the set-point (m), its velocity (m/s), the deflection of the load from the axis (m), its rate
(m/s), and the last commanded change of velocity (m/s), which acts on the load one step later
(inferred: of 0, 1/2 and 1 step, only 1 settled every episode on the spring with the weights below).
The command is the change of the velocity in a step. The regulator acts on the deviation from a path
that is shaped for the nominal resonance.
"""

import math
from typing import Any

import numpy as np

from ...envs.view.about import Sensor
from .datasheet import Axis, Datasheet, Vibration
from .profiles import of_the_drive, resonance, shaped, time_optimal

# Weights, in units of the nominal resonance; tuned on 64 episodes, none of them of an evaluation
VELOCITY = 3.0  # of the load's velocity / frequency, against its distance
EFFORT = 0.3  # of the acceleration / frequency²
SHAPERS = 1  # of the path, best of 0, 1 and 2


def model(vibration: Vibration, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the state and input matrices of one step: shapes ``(5, 5)``, ``(5, 1)``."""
    frequency, ratio = vibration
    damped = frequency * math.sqrt(1.0 - ratio**2)
    decay, share = math.exp(-ratio * frequency * dt), ratio * frequency / damped
    s, c = decay * math.sin(damped * dt), decay * math.cos(damped * dt)
    swing = np.array([[c + share * s, s / damped], [-(frequency**2) / damped * s, c - share * s]])
    a = np.eye(5)
    a[0, 1] = dt
    a[2:4, 2:4] = swing
    a[4, 4] = 0.0
    a[2:4, 4] = -swing[:, 1]
    return a, np.array([[dt], [1.0], [0.0], [0.0], [1.0]])


def weights(vibration: Vibration, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the weights of state and input in a step and the cost-to-go matrix.

    Shapes ``(5, 5)``, ``(1, 1)``, ``(5, 5)``.

    Raises:
        ImportError: scipy is missing; the message has the command.
    """
    try:
        from scipy.linalg import solve_discrete_are
    except ModuleNotFoundError as error:
        raise ImportError(f"lqr needs scipy ({error}): pip install 'servogym[lqr]'") from None
    frequency = vibration.frequency
    a, b = model(vibration, dt)
    load = np.array([[1.0, 0.0, 1.0, 0.0, 0.0]])
    speed = np.array([[0.0, 1.0, 0.0, 1.0, 0.0]]) / frequency
    q = load.T @ load + VELOCITY * speed.T @ speed
    r = np.array([[EFFORT / (frequency**2 * dt) ** 2]])
    return q, r, solve_discrete_are(a, b, q, r)


def gain(vibration: Vibration, dt: float) -> np.ndarray:
    """Return the state feedback, shape ``(5,)``: change of velocity per state."""
    a, b = model(vibration, dt)
    _, r, p = weights(vibration, dt)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)[0]


def sensed(datasheet: Datasheet, axis: Axis) -> Sensor:
    """Return the sensor of the load. Raises ValueError if there is none."""
    if axis.sensor is None:
        raise ValueError(
            "this policy needs the sensor of the load, as 'lqr' does: make "
            f"{datasheet.task} with {datasheet.sensor}=True"
        )
    return axis.sensor


class Regulated:
    """The controller of one axis: its path, the state along it, and feedback of the deviation."""

    def __init__(self, datasheet: Datasheet, axis: Axis):
        self._axis, self._sensor, self._dt = axis, sensed(datasheet, axis), datasheet.step_time
        self._vibration = resonance(datasheet, axis)
        self._bounds = of_the_drive(axis)
        self._change = self._bounds.acceleration * datasheet.step_time
        self._model = model(self._vibration, datasheet.step_time)
        self._gain = gain(self._vibration, datasheet.step_time)
        self._times = np.arange(datasheet.steps + 1) * datasheet.step_time
        incline = axis.weight / (axis.carriage + axis.payload)  # m/s²
        self._rest = -incline / self._vibration.frequency**2

    def reset(self, seen: Any) -> None:
        """Plan from the observations of the axis."""
        path = time_optimal(float(seen.distance) * self._axis.stroke - self._rest, self._bounds)
        for _ in range(SHAPERS):
            path = shaped(path, *self._vibration)
        self._steps = np.diff(path(self._times)) / self._dt  # velocities (m/s)
        self._expected, self._step = np.zeros(5), 0
        self._place = self._velocity = self._last = 0.0

    def act(self, seen: Any) -> float:
        """Return the velocity of the set-point (m/s)."""
        wanted = self._steps[self._step] if self._step < len(self._steps) else 0.0
        planned = wanted - self._expected[1]
        change = planned - float(self._gain @ (self.state(seen) - self._expected))
        a, b = self._model
        self._expected = a @ self._expected + b[:, 0] * planned
        self._step += 1
        return self.changed(change)

    def state(self, seen: Any, origin: float = 0.0) -> np.ndarray:
        """Return the observed state, shape ``(5,)``, the set-point relative to an origin (m)."""
        deflection = float(seen[self._sensor.name]) * self._sensor.deflection - self._rest
        rate = float(seen[self._sensor.rate_name]) * self._sensor.rate
        return np.array([self._place - origin, self._velocity, deflection, rate, self._last])

    def changed(self, change: float) -> float:
        """Return the velocity of the set-point (m/s) after a change, within the limits."""
        change, top = min(max(change, -self._change), self._change), self._axis.speed
        velocity = min(max(self._velocity + change, -top), top)
        self._last, self._velocity = velocity - self._velocity, velocity
        self._place += velocity * self._dt
        return velocity


class Lqr:
    """Regulates each axis separately."""

    AXIS: type[Regulated] = Regulated

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known = datasheet
        self._axes = [self.AXIS(datasheet, axis) for axis in (datasheet.axis, *datasheet.axes[1:])]

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Plan the paths."""
        for one, seen in zip(self._axes, self._known.named_by_axis(observation), strict=True):
            one.reset(seen)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the velocities of the set-points."""
        named_by_axis = self._known.named_by_axis(observation)
        velocities = [
            one.act(seen) / axis.speed
            for one, axis, seen in zip(self._axes, self._known.axes, named_by_axis, strict=True)
        ]
        return np.clip(self._known.action(velocity=velocities), -1.0, 1.0)
