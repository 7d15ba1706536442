"""The status of a drive in words: its faults, and reasons why it does not obey."""

import math

from .kernel.cascade import Structure
from .kernel.faults import Cause
from .kernel.record import Axis
from .kernel.words import (
    NONE_OWN,
    Command,
    Limit,
    OwnModes,
    State,
    Statusword,
    command_of,
    decode_controlword,
    decode_statusword,
    state_of,
)
from .model.model import DriveModel

# conditions of commands (CiA 402-2, transitions 2-16)
OBEYED = {
    Command.SHUTDOWN: "it is obeyed in SWITCH_ON_DISABLED, SWITCHED_ON and OPERATION_ENABLED",
    Command.SWITCH_ON: "it is obeyed in READY_TO_SWITCH_ON: send shutdown (0006h) first",
    Command.ENABLE_OPERATION: "it is obeyed in READY_TO_SWITCH_ON and SWITCHED_ON (and in "
    "QUICK_STOP_ACTIVE with 605Ah = 5..8): send shutdown (0006h), then switch on (0007h) first",
    Command.DISABLE_VOLTAGE: "the power stage is already off",
    Command.QUICK_STOP: "there is nothing to stop",
    Command.FAULT_RESET: "it is obeyed in FAULT, when the cause of the fault is gone",
}

# states to which a command leads (CiA 402-2; after a quick stop 605Ah decides)
LEADS_TO = {
    Command.SHUTDOWN: (State.READY_TO_SWITCH_ON,),
    Command.SWITCH_ON: (State.SWITCHED_ON,),
    Command.ENABLE_OPERATION: (State.OPERATION_ENABLED,),
    Command.DISABLE_VOLTAGE: (State.SWITCH_ON_DISABLED,),
    Command.QUICK_STOP: (
        State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON,
        State.SWITCHED_ON,
    ),
}

# hindrances of any command: statusword bit, whether it is set, quirk and its value, next step
HINDRANCES = (
    (Statusword.REMOTE, False, "remote_bit", 0,
     "remote (bit 9) is 0: the drive is under local control, release it"),
    (Statusword.REMOTE, False, "remote_bit", 1,
     "remote (bit 9) is 0: the bus may not enable the drive, 6510h:10h = 2 allows it"),
    (Statusword.VOLTAGE_ENABLED, False, "voltage_bit", 0,
     "voltage_enabled (bit 4) is 0: switch on the power, allow torque (STO)"),
    (Statusword.INTERNAL_LIMIT_ACTIVE, True, "limit_bit_is_i2t", 0,
     "internal_limit_active (bit 11): look for a limit switch or a limit of 607Dh, 6072h, 607Fh"),
    (Statusword.INTERNAL_LIMIT_ACTIVE, True, "limit_bit_is_i2t", 1,
     "internal_limit_active (bit 11): I²t limits the current, command less or wait"),
)

# limits in `AXIS.od.active_limits` that hold a drive back while bit 11 is set
HELD_BACK = {
    Limit.TORQUE: "the torque limit 6072h, 6073h, 60E0h or 60E1h: accelerate less",
    Limit.SPEED: "the speed limit 607Fh or 6080h: command less",
    Limit.SOFTWARE_POSITION_MIN: "the software limit 607Dh:01: choose a target inside",
    Limit.SOFTWARE_POSITION_MAX: "the software limit 607Dh:02: choose a target inside",
    Limit.NEGATIVE_LIMIT_SWITCH: "the negative limit switch: move in positive direction",
    Limit.POSITIVE_LIMIT_SWITCH: "the positive limit switch: move in negative direction",
    Limit.I2T: "I²t, which limits the current: command less, or wait",
    Limit.VELOCITY_AMOUNT: "the amounts 6046h of the velocity: command between them",
    Limit.VOLTAGE: "the voltage of the DC link, which drives no more current against this speed: "
    "lower the speed 6081h or the acceleration 6083h, or choose a motor with a lower voltage "
    "constant or a higher supply",
}

# remedies by cause (inferred from the causes; manuals recommend much the same)
REMEDIES = {
    Cause.ENCODER_LOSS: "check encoder, plug and cable; the position is lost, home again",
    Cause.FOLLOWING_ERROR: "lower the acceleration 6083h or speed 6081h, look for friction or a "
    "blocked axis, check the gains; the window is 6065h, its time 6066h",
    Cause.OVERSPEED: "lower the speed, check the limit 6080h and the gains",
    Cause.I2T: "lower the acceleration or the load: the motor needs peak torque for too long",
    Cause.MOTOR_TEMPERATURE: "let the motor cool; lower the load, or choose a larger motor",
    Cause.OVERVOLTAGE: "brake more gently, or fit a brake resistor: braking feeds the DC link",
    Cause.UNDERVOLTAGE: "check the supply of the power stage",
    Cause.SET_POINT_LOSS: "the master has stopped sending set-points: check its cycle and the bus",
    Cause.CONNECTION: "check the bus and the master; 6007h says what a lost connection does",
    Cause.SHORT_CIRCUIT: "check motor and motor cable",
    Cause.DRIVE_TEMPERATURE: "let the drive cool; check its ventilation",
    Cause.EXTERNAL: "look at what reports it; the code has the manufacturer's words",
    Cause.RPDO_TIMEOUT: "the master has stopped sending PDOs: check its cycle and the bus",
    Cause.POSITION_ERROR: "lower acceleration or speed, look for friction or a blocked axis",
    Cause.HOMING_INTERRUPTED: "start homing again and let it end",
    Cause.HOMING_SWITCH: "the home switch was not found: check its wiring and place",
    Cause.HOMING_INDEX: "no index pulse came: check the encoder and its cable",
    Cause.HOMING_TIMEOUT: "homing takes too long: check the switch, raise the speeds 6099h",
    Cause.NEGATIVE_BLOCKED: "move in positive direction, off the limit switch",
    Cause.POSITIVE_BLOCKED: "move in negative direction, off the limit switch",
    Cause.SYNC_LOST: "SYNC stays away: check the master's cycle and 60C2h",
    Cause.GUARDING: "the master's guarding stays away: check the master and the bus",
    Cause.RPDO_TOO_SHORT: "an RPDO has too few bytes: compare its mapping with the master's",
    Cause.SOFTWARE_LIMIT_MIN: "choose a target inside 607Dh, or other limits",
    Cause.SOFTWARE_LIMIT_MAX: "choose a target inside 607Dh, or other limits",
    Cause.INDEX_NEAR: "move the home switch, or turn the coupling, by half a revolution",
}


# faults that the control loops may cause
OF_LOOPS = (Cause.FOLLOWING_ERROR, Cause.POSITION_ERROR, Cause.OVERSPEED, Cause.I2T)


def describe(statusword: int, mode: int, own: OwnModes = NONE_OWN) -> str:
    """The statusword by name; `own` are modes of the drive model."""
    return f"{statusword:04X}h {' '.join(decode_statusword(statusword, mode, own))}"


def situation(statusword: int, controlword: int, mode: int) -> str:
    """Statusword and last controlword in words."""
    words = " ".join(decode_controlword(controlword, mode))
    return f"statusword {describe(statusword, mode)}; last controlword {controlword:04X}h {words}"


def advice(model: DriveModel, statusword: int, controlword: int) -> str:
    """The next step if a drive does not obey the controlword."""
    hindrances = [
        text
        for bit, is_set, quirk, kind, text in HINDRANCES
        if bool(statusword & bit) == is_set and model.quirk(quirk) == kind
    ]
    command = command_of(controlword)
    if state_of(statusword) in LEADS_TO.get(command, ()):
        needed = f"it obeys {command.name}: look at the limit switches (60FDh) and the mode (6061h)"
    else:
        needed = f"{command.name}: {OBEYED[command]}; else look for a missing enable input (60FDh)"
    return "; ".join(hindrances) or needed


def unheeded(model: DriveModel, statusword: int, controlword: int) -> str:
    """Reason why a drive is not in the state to which its controlword leads; empty if it is."""
    state, command = state_of(statusword), command_of(controlword)
    if state is None or state in LEADS_TO.get(command, (state,)):
        return ""
    if state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
        needed = "a fault has stopped the drive: reset it first"
    else:
        needed = advice(model, statusword, controlword)
    return f"{command.name} has not led out of {state.name}: {needed}"


def fault_named(model: DriveModel, code: int) -> str:
    """An error code 603Fh with its meaning in the model; empty for 0."""
    words = next((fault.meaning for fault in model.faults if fault.code == code), "")
    return f"{code:04X}h {words}".strip() if code else ""


def remedy_of(model: DriveModel, code: int) -> str:
    """Remedy for an error code 603Fh, if the cause in the drive is unknown."""
    causes = (fault.cause for fault in model.faults if fault.code == code)
    known = (REMEDIES[cause] for cause in causes if cause in REMEDIES)
    return next(known, "look it up in the manual of the drive")


def structure(axis: Axis) -> list[str]:
    """Parts of the control loops other than the P-PI cascade, and their effects."""
    od, said = axis.od, []
    if od.control_structure == Structure.PID:
        p, i, d = od.pid_gain * 1e-6, od.pid_integral_gain * 1e-3, od.pid_derivative_gain * 1e-6
        said.append(
            f"a PID position controller gives the torque (P {p:.3g} Nm/rad, I {i:.3g} Nm/(rad·s), "
            f"D {d:.3g} Nm·s/rad): in position modes the velocity controller's gains do nothing"
        )
    for tenths in od.notch_frequency.tolist():
        if tenths > 0:
            said.append(
                f"a notch filter at {0.1 * tenths:g} Hz shapes the torque: it takes phase from "
                "loops that cross over below it, and helps only at the resonance it was set to"
            )
    if od.torque_command_filter_time > 0:
        said.append(
            f"a low-pass of {od.torque_command_filter_time} µs smooths the torque and delays it by "
            "as much: lower the gains with it"
        )
    if od.observer_bandwidth > 0:
        inertia = od.observer_inertia * 1e-12 or od.acceleration_feed_forward * 1e-9
        said.append(
            f"the speed is that of an observer of {0.1 * od.observer_bandwidth:g} Hz for "
            f"{inertia:.3g} kg·m²: with another inertia at the shaft it errs in acceleration"
        )
    constant = (od.motor_voltage_constant or od.motor_torque_constant) * 1e-6
    if od.motor_resistance > 0 and constant > 0.0:
        no_load = od.supply_voltage * 1e-3 / constant * 30 / math.pi
        said.append(
            f"the winding on {od.supply_voltage * 1e-3:.0f} V gives less torque the faster it "
            f"turns, and none at {no_load:.0f} 1/min"
        )
    return said


def refusal(axis: Axis) -> str:
    """The reason of the last refusal: command, state, and missing condition.

    If there was none, the limits that hold the drive back and `structure`.
    """
    command = Command(int(axis.refused_command))
    if command is Command.NONE:
        held = [words for limit, words in HELD_BACK.items() if axis.od.active_limits & limit]
        held = [f"held back by {words}" for words in held]
        return "; ".join(["no command has been refused", *held, *structure(axis)])
    state = State(int(axis.refused_state))
    needed = OBEYED[command]
    if not axis.sto_input or not axis.enable_input:
        needed = "an enable input is missing: safe torque off or controller enable"
    elif command is Command.FAULT_RESET and axis.faults_present:
        present = int(axis.faults_present & ~axis.warnings)
        needed = f"still present: {', '.join(c.name for c in Cause if c and present >> c & 1)}"
    return f"{command.name} was refused in {state.name}: {needed}"


def meaning(model: DriveModel, axis: Axis, cause: int) -> str:
    """Error code and meaning of a cause of faults, empty if the model has no row for it."""
    code = int(axis.fault_code[cause])
    for fault in model.faults if cause else ():
        external = cause == Cause.EXTERNAL and fault.code == code
        if fault.cause == cause or external:
            return f"{fault.code:04X}h {fault.meaning}"
    return ""


def remedy(axis: Axis) -> str:
    """Remedy for the fault that has stopped the drive, and the next step."""
    cause = Cause(int(axis.fault))
    present = axis.faults_present & ~axis.warnings & 1 << int(axis.fault)
    step = (
        "the cause is still present, so a reset is refused" if present else "then reset the fault"
    )
    loops = structure(axis) if cause in OF_LOOPS else []
    return "; ".join([REMEDIES.get(cause, "look it up in the manual of the drive"), *loops, step])


def cause_of(axis: Axis) -> str:
    """Name for `Drive.inject` of the cause that has stopped the drive; empty if there is none."""
    return Cause(int(axis.fault)).name.lower() if axis.fault else ""


def refused(axis: Axis) -> str:
    """The last refused command; empty if there is none."""
    return Command(int(axis.refused_command)).name if axis.refused_command else ""
