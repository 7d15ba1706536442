"""New logs of machines whose twin is known: nothing has changed since, or one parameter has."""

import functools
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from machines import csp_log, hide

from servogym.envs.engine import parameters
from servogym.envs.twin.families import FAMILIES
from servogym.training.cli import main
from servogym.training.cli.twin import GAIN_OBJECTS

HIDDEN = ("coulomb_friction", "viscous_friction")
GAPS = {"ball_screw": ["backlash"]}  # hidden too, and looked for in the first log
SLOW = {"ball_screw": {"speed": (0.05, 0.3), "acceleration": (1, 4)}}
CHANGES = (  # mechanics, what changes, its parameter and (factor, more), logs
    ("rigid", "nothing", {}, 10),
    ("rigid", "Coulomb friction +18 %", {"coulomb_friction": (1.18, 0.0)}, 2),
    ("rigid", "viscous friction +40 %", {"viscous_friction": (1.4, 0.0)}, 1),
    ("rigid", "payload +5 %", {"payload": (1.05, 0.0)}, 1),
    ("rigid", "a constant force of 4 N", {"load_force": (1.0, 4.0)}, 1),
    ("ball_screw", "nothing", {}, 3),
    ("ball_screw", "backlash +4 µm", {"backlash": (1.0, 4e-6)}, 2),
)


def _log(mechanics, change, seed, file):
    """A log of its moves in csp; -> the machine, what has changed."""
    family = FAMILIES[mechanics]
    machine = family.make("generic")
    names = [family.mass, *HIDDEN, *GAPS.get(mechanics, [])]
    hide(machine, np.random.default_rng(1600), names)
    before = parameters.get(machine, list(change))
    parameters.apply(machine, {n: f * before[n] + more for n, (f, more) in change.items()})
    csp_log(machine, file, np.random.default_rng(seed), dropped=0.005, jitter=2e-4, seconds=4.0,
            **SLOW.get(mechanics, {}))
    return machine, {name: value - before[name]
                     for name, value in parameters.get(machine, list(change)).items()}


@functools.cache
def twin(mechanics):
    """The folder of the twin that the machine had when it was new."""
    where = tempfile.TemporaryDirectory()
    folder = Path(where.name)
    machine, _ = _log(mechanics, {}, 1599, folder / "new.log")
    od = machine.drives["x"].axis.od
    gains = {name: int(getattr(od, name)) for name in GAIN_OBJECTS}
    (folder / "gains.json").write_text(json.dumps(gains))
    assert main(["twin", str(folder / "new.log"), "--mechanics", mechanics, "--read-gains",
                 str(folder / "gains.json"), "--free", ",".join(GAPS.get(mechanics, [])),
                 "-o", str(folder / "twin")]) == 0
    return where, folder / "twin"


def play(mechanics, change, seed):
    """What `servogym twin --against` says of a new log, and what is true."""
    _, old = twin(mechanics)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _, true = _log(mechanics, change, seed, folder / "a.log")
        begin = time.process_time()
        main(["twin", "--against", str(old), str(folder / "a.log"), "-o", name])
        cost = time.process_time() - begin
        found = json.loads((folder / "health.json").read_text(encoding="utf-8"))
    return {
        "verdict": found["verdict"], "cpu": round(cost, 1),
        "changes": {each.pop("name"): each for each in found["changes"]}, "true": true,
    }
