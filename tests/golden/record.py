"""Record the scripted commissioning of drive models anew: ``cd tests; python -m golden.record``.

Names of models may follow; without them all are recorded. The end of each step is checked, so
what is written down is a drive that has homed, arrived, and told the faults of its manual.
"""

import struct
import sys
from pathlib import Path

from golden import inverter
from golden.can_master import CanMaster
from golden.ethercat_master import EthercatMaster
from golden.rig import CanRig, rig

from servogym.drive.canopen.frame import Frame
from servogym.drive.kernel.words import Controlword as C
from servogym.drive.kernel.words import Mode, State, state_of
from servogym.drive.kernel.words import Statusword as S
from servogym.drive.objects.abort import Abort
from servogym.envs.plants.linear_axis import linear_axis

HERE = Path(__file__).parent
LOGS = {  # drive model -> file
    "generic": "generic.log",
    "festo_cmmp_as": "festo_cmmp_as.log",
    "festo_cmmp_as_m0": "festo_cmmp_as_m0.log",
    "festo_cmms": "festo_cmms.log",
    "festo_cmmd": "festo_cmmd.log",
    "metronix_ars2000": "metronix_ars2000.log",
    "kollmorgen_akd": "kollmorgen_akd.txt",
    "bonfiglioli_act": "bonfiglioli_act.log",
}
SCRIPTS = {"bonfiglioli_act": inverter.commission}  # drive model -> script, else that of a servo
SHUTDOWN, SWITCH_ON, ENABLE = 0x06, 0x07, 0x0F
SHORT_CIRCUIT, FOLLOWING_ERROR, FRAMES_LOST = 0x2320, 0x8611, 0x8700
TOO_SHORT, GUARDING = 0x8210, 0x8130
SWITCH_OFF_LIMIT = (0x6510, 0x22)  # of the models in which a following error is a message only
MAX_CURRENT = (0x6073, 0)
HOMING_METHOD = (0x6098, 0)
FACTOR_GROUP = (0x6093, 0x6094, 0x6097)
SAVE = b"save"
NEAR = 20  # µm, position window
MICRO = 1e6


def parameters(model):
    """What the axis needs and the drive does not have as delivered: (index, subindex) -> bytes."""
    drive = linear_axis(model).drives["x"]

    def values():
        return {
            address: slot.code.pack(slot.get())
            for address, slot in drive.objects.slots.items()
            if address[0] >= 0x2000 and slot.row.access == "rw" and slot.row.storable
            and slot.row.format and slot.row.area == "axis"
        }

    wanted = values()
    drive.reset()
    # the factor group comes first: values keep their meaning when it changes (Metronix 6.3.1)
    first = FACTOR_GROUP if drive.model.quirk("values_keep_meaning") else ()
    changed = {address: data for address, data in wanted.items() if address[0] in first}
    for (index, subindex), data in changed.items():
        assert not drive.objects.write(index, subindex, data)
    delivered = values()
    changed |= {address: data for address, data in wanted.items() if data != delivered[address]}
    changed[HOMING_METHOD] = wanted[HOMING_METHOD]
    if SWITCH_OFF_LIMIT in wanted:
        changed[SWITCH_OFF_LIMIT] = struct.pack("<I", 5_000)
    return changed


def commission(bus):
    """From the first telegram to the last; -> the log."""
    on_can = isinstance(bus, CanRig)
    master = CanMaster(bus) if on_can else EthercatMaster(bus)
    configure(master, parameters(bus.model))
    master.start()
    enable(master)
    home(master)
    move(master, 250_000)
    internal_fault(master)
    following_error(master)
    move(master, 100_000)
    if on_can:
        short_rpdo(master)
        lost_guarding(master)
    else:
        lost_frames(master)
    stop(master)
    master.end()
    return bus.log


def configure(master, wanted):
    """Identity, parameters, save, PDOs."""
    if isinstance(master, EthercatMaster):
        master.boot()
    for station in master.stations:
        for subindex in (1, 2, 3):
            expected = station.drive.read(0x1018, subindex)
            assert int.from_bytes(master.read(station, 0x1018, subindex), "little") == expected
        for (index, subindex), data in wanted.items():
            master.write(station, index, subindex, data)
        # access counts before length, as the example of 3.2.2 of the Festo manual shows
        master.refused(station, 0x6041, 0, bytes(4), Abort.READ_ONLY)
        master.refused(station, 0x6041, 7, bytes(2), Abort.NO_SUBINDEX)
        master.prepare(station)
        if master.rig.model.quirk("pdo_needs_stop"):  # the PDO is on now
            master.refused(station, 0x1600, 0, b"\0", Abort.DEVICE_STATE)
        master.write(station, 0x1010, 1, SAVE)


def control(master, word, state, stations=None):
    master.set(stations, controlword=word)
    master.wait(lambda s: s.state is state, f"controlword {word:04X}h", stations=stations)


def enable(master, stations=None):
    for word, state in (
        (SHUTDOWN, State.READY_TO_SWITCH_ON),
        (SWITCH_ON, State.SWITCHED_ON),
        (ENABLE, State.OPERATION_ENABLED),
    ):
        control(master, word, state, stations)


def select(master, mode):
    master.set(mode=mode)
    master.wait(lambda s: s.mode_display == mode, f"mode {mode.name}")


def truth(station):
    """Position of the carriage (µm)."""
    return station.axis.data.qpos[0] * MICRO


def home(master):
    select(master, Mode.HOMING)
    master.set(controlword=ENABLE | C.NEW_SET_POINT)
    done = S.MODE_12 | S.TARGET_REACHED
    master.wait(lambda s: s.statusword & (done | S.MODE_13) == done, "homing")
    master.set(controlword=ENABLE)
    for station in master.stations:
        assert station.drive.axis.homed
        assert abs(station.position - truth(station)) < 500  # the switch is found at 10 mm/s
    select(master, Mode.PROFILE_POSITION)


def begin(master, target, stations=None):
    """Hand over a set-point."""
    master.set(stations, controlword=ENABLE, target=target)
    master.set(stations, controlword=ENABLE | C.NEW_SET_POINT)
    master.run(2)
    master.set(stations, controlword=ENABLE)


def move(master, target):
    begin(master, target)
    master.wait(lambda s: s.statusword & S.TARGET_REACHED and not s.statusword & S.MODE_12,
                f"target {target}")
    for station in master.stations:
        assert abs(station.position - target) <= NEAR
        assert abs(station.position - truth(station)) < 500


def expect(master, station, code):
    """FAULT in the process data, with the error code."""
    master.wait(lambda s: s.faulty, f"fault {code:04X}h", 2.0, [station])
    told_by(master, station, code)


def told_by(master, station, code):
    """The error code is in the history, came by EMCY, and is one of the manual's."""
    told = master.read(station, 0x1003, 1)
    assert int.from_bytes(told[:2], "little") == code, f"{told.hex()}, not {code:04X}h"
    assert code in {fault.code for fault in station.drive.model.faults}
    if isinstance(master, CanMaster):
        assert station.emergencies[-1] == code


def reset(master, stations):
    master.set(stations, controlword=0)
    master.set(stations, controlword=int(C.FAULT_RESET))
    master.wait(lambda s: s.state is State.SWITCH_ON_DISABLED, "fault reset", stations=stations)
    master.set(stations, controlword=0)
    enable(master, stations)


def internal_fault(master):
    """A short circuit in the first drive only."""
    station, *others = master.stations
    master.cause(station, SHORT_CIRCUIT)
    expect(master, station, SHORT_CIRCUIT)
    assert all(other.state is State.OPERATION_ENABLED for other in others)
    master.set([station], controlword=int(C.FAULT_RESET))
    master.run(3)
    assert station.faulty, "the cause is still present"
    master.cause(station)
    reset(master, [station])


def following_error(master):
    """Too little torque for a move."""
    station = master.stations[0]
    torque = master.read(station, *MAX_CURRENT)
    master.write(station, *MAX_CURRENT, struct.pack("<H", 50))
    begin(master, 400_000, [station])
    expect(master, station, FOLLOWING_ERROR)
    master.write(station, *MAX_CURRENT, torque)
    reset(master, [station])


def short_rpdo(master):
    """An RPDO without its target position: told, not used, and the drive goes on."""
    station = master.stations[0]
    master.tick(Frame(0x200 + station.node_id, struct.pack("<Hb", 0, 1)))
    master.run(3)
    assert TOO_SHORT in station.emergencies
    assert station.state is State.OPERATION_ENABLED
    master.set()
    master.run(3)


def lost_guarding(master):
    """The master falls silent: FAULT, and the node leaves OPERATIONAL (1029h, 0 by default)."""
    master.guards = False
    master.run(20)
    for station in master.stations:
        statusword = int.from_bytes(master.read(station, 0x6041, 0), "little")
        assert state_of(statusword) in (State.FAULT, State.FAULT_REACTION_ACTIVE)
        assert station.state is State.OPERATION_ENABLED, "no TPDO since"
        told_by(master, station, GUARDING)
    master.guards = True
    master.start()
    master.run(6)
    reset(master, master.stations)


def lost_frames(master):
    """Seven frames may stay away, more are a fault (F125)."""
    for frames in (7, 10):
        assert master.stations[0].state is State.OPERATION_ENABLED
        master.running = False
        master.run(frames)
        master.running = True
        master.run(2)
    expect(master, master.stations[0], FRAMES_LOST)
    reset(master, master.stations)


def stop(master):
    """Quick stop in the middle of a move."""
    begin(master, 400_000)
    master.run(4)
    assert all(100_500 < s.position < 399_500 for s in master.stations)
    control(master, ENABLE & ~C.QUICK_STOP, State.SWITCH_ON_DISABLED)
    master.set(controlword=0)
    before = [truth(station) for station in master.stations]
    master.run(2)
    after = [truth(station) for station in master.stations]
    assert all(abs(a - b) < NEAR for a, b in zip(after, before, strict=True)), (before, after)


def main(models):
    for model in models or LOGS:
        log = SCRIPTS.get(model, commission)(rig(model))
        (HERE / LOGS[model]).write_text("\n".join(log) + "\n")
        print(f"{LOGS[model]}: {len(log)} lines")


if __name__ == "__main__":
    main(sys.argv[1:])
