"""The SDK of a motor maker, hdrive-etc with its ethercat-master, as it stands, beside `serve`.

Both are other people's packages (MIT), installed by name. The folder `hdrive` is a drive model with
the process data that the SDK expects.
"""

import contextlib
import json
import math
import tempfile
import time
from pathlib import Path

from deployed import _network, machine_served
from ethercat_master import EtherCATBus
from hdrive_etc import HDriveETC, Mode

ROWS = {
    "bus": {"line": {"kind": "ethercat", "interface": "va", "clock": "real"}},
    "machine": {
        "table": {
            "bus": "line", "axis": "rotary-table",
            "drive": str(Path(__file__).parent / "hdrive"),
        },
    },
}
PDOS = {"default": {"rx_pdo": ["0x1600", "0x1605"], "tx_pdo": ["0x1A00", "0x1A05"]}}
CYCLE = 5  # ms, between its set-points
LATE = "did not go on in time"  # wire.py then tries anew


def until(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(LATE)
        time.sleep(2e-3)


@contextlib.contextmanager
def enabled():
    """Its motor, which it has enabled."""
    config = Path(tempfile.mkdtemp(), "ethercat_config.json")
    config.write_text(json.dumps(PDOS))  # as its web page writes it
    with HDriveETC(
        adapter="vb", cycle_time_ms=CYCLE, pdo_config_path=str(config)
    ) as motor:
        motor.set_mode(Mode.PROFILE_VELOCITY)
        until(lambda: motor.get_state_name() == "operation_enabled")
        yield motor


def along(motor, ask, degrees, seconds=1):
    """Ways (rad) after some csp: the table's, and what the SDK counts, in tenths of a unit."""
    motor.set_position(motor.get_position())
    motor.set_mode(Mode.POSITION)
    until(lambda: motor.get_status()["mode_display"] == Mode.POSITION)
    begin = motor.get_position()
    ((_, at, _),) = ask("look")
    steps, sent = seconds * 1000 // CYCLE, time.monotonic()
    for k in range(steps + 1):
        s = k / steps
        motor.set_position(begin + 100 * degrees * (10 * s**3 - 15 * s**4 + 6 * s**5))
        time.sleep(1e-3 * CYCLE)
        before, sent = sent, time.monotonic()
        if sent - before > 2.5e-3 * CYCLE:
            raise TimeoutError(LATE)
    time.sleep(0.3)
    ((_, there, _),) = ask("look")
    return [there - at, (motor.get_position() - begin) * 0.01 * math.pi / 180]


def staircase():
    """50 degrees, while the drive expects a set-point each ms (60C2h) and gets one in five."""
    _network()
    with machine_served(ROWS) as ask, enabled() as motor:
        way = along(motor, ask, 50)
        return {"way": way, "period": motor.read_sdo(0x60C2, 1), "fault": motor.get_error_code()}


def moved():
    """What the SDK says and what the table does, in three modes and after a fault."""
    _network()
    told = {}
    with machine_served(ROWS) as ask:
        told["found"] = [slave["name"] for slave in EtherCATBus.discover("vb")]
        with enabled() as motor:
            here = motor.get_position()
            motor.set_velocity(20_000)  # units of 0.001 degree a second
            time.sleep(0.5)
            ((_, _, told["velocity"]),) = ask("look")
            motor.set_velocity(0)
            until(lambda: abs(motor.get_status()["velocity"]) < 2_000)
            told["turned"] = motor.get_position() > here
            told["5"] = along(motor, ask, 5)
            motor.write_sdo(0x60C2, 1, CYCLE, "B")
            told["50"] = along(motor, ask, 50, seconds=3)
            if motor.get_error_code() == 0x8611:  # its thread was held up for some cycles
                raise TimeoutError(LATE)
            told["sdo"] = motor.read_sdo(0x1000, 0)
            told["error"] = motor.get_error_code()
            ask("inject", "overvoltage")
            until(lambda: motor.get_state_name() == "fault")
            told["fault"] = motor.get_error_code()
        told["end"] = ask("look")[0][0]
    return told
