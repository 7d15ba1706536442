"""The one master of the house over SOEM, beside `servogym ethercat`."""

import subprocess
import sys
import time

from servogym.drive.ethercat.port import EtherCatPort
from servogym.drive.master import Master, Refused, Units
from servogym.drive.wire.soem import SoemMaster


def enable_home_and_move():
    soem = SoemMaster("vb")
    port = EtherCatPort(
        soem, {"x": "kollmorgen_akd"}, now=time.monotonic, units=Units(1e-6, 1e-6, "m")
    )
    axis = Master(port)
    axis.enable(timeout=20)
    enabled = axis.state.name
    axis.home(17)
    places = []
    for target in (0.05, 0.15):
        axis.move_to(target, timeout=60)
        places.append(axis.position)
    try:
        axis.write("homing_method", 99)
        refused = ""
    except Refused as error:
        refused = str(error.__cause__)
    axis.disable()
    disabled = axis.state.name
    soem.close()
    return {"enabled": enabled, "places": places, "refused": refused, "wrong": soem.wrong,
            "disabled": disabled}


def second_server():
    """Exit status and words of another server on the same interface."""
    command = [sys.executable, "-m", "servogym.training.cli", "ethercat", "-i", "va"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    return done.returncode, done.stderr
