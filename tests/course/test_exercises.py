"""The exercises: each has a solution that passes, and wrong ways that do not."""

import contextlib
import functools
from itertools import permutations

import pytest

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.node import Node
from servogym.drive.kernel.words import Mode
from servogym.drive.master import ServoError
from servogym.drive.objects.abort import SdoAbort
from servogym.envs.course import exercise as files
from servogym.envs.course.laboratory import Laboratory

NAMES = [path.stem for path in sorted(files.SHIPPED.glob("*.toml"))]


@functools.cache
def laboratory():
    """One machine for all of them."""
    return Laboratory(NAMES[0])


def begin(name):
    """An exercise on the machine as it was handed over."""
    laboratory().begin(name)
    return laboratory()


# ------------------------------------------------------------------ solutions


def power(lab):
    lab.control(0x0F)
    lab.control(0x06)
    lab.control(0x07, 0x0F)
    lab.predict(1)
    lab.control(0x02)
    lab.wait(0.5)
    lab.control(0x06, 0x07, 0x0F)


def under_way(lab, method=37):
    """Enabled, referenced here, and on the way to 400 mm."""
    lab.master.enable()
    lab.master.home(method)
    start(lab, 400_000)
    lab.wait(0.5)


def start(lab, target):
    """A profile position move to a target (drive units), under way."""
    lab.master.set_mode(Mode.PROFILE_POSITION)
    lab.drive.write("target_position", target)
    lab.control(0x0F, 0x1F)


def stop_it(lab):
    under_way(lab)
    lab.predict(1)
    lab.drive.write("controlword", 0x02)
    lab.wait(1.0)


def overvoltage(lab):
    lab.master.enable()
    lab.wait(0.02)
    lab.predict(1)
    lab.control(0x00, 0x80)
    lab.drive.clear_injected()
    lab.control(0x00, 0x80, 0x06, 0x07, 0x0F)


def home_to_a_switch(lab):
    lab.predict(1)
    lab.master.enable()
    lab.master.home(17)
    lab.master.move_to(0.25)
    lab.drive.write("speed_during_search_for_switch", 50_000)
    lab.master.home(17)


def tripped(lab):
    """Homed, and stopped by the following error."""
    lab.master.enable()
    lab.master.home(17)
    with contextlib.suppress(ServoError):
        lab.master.move_to(0.4)


def find_why_it_trips(lab):
    tripped(lab)
    lab.drive.write("max_torque", 3000)
    lab.master.reset_fault()
    lab.master.enable()
    lab.master.move_to(0.4)


def units(lab):
    lab.master.enable()
    lab.master.home(37)
    start(lab, 75_000)
    lab.wait(2.0)
    lab.drive.write("profile_velocity", 40_000)
    start(lab, 0)
    lab.wait(3.0)


def position_gain(lab):
    lab.predict(1)
    lab.master.enable()
    lab.master.home(37)
    start(lab, 300_000)
    lab.wait(3.0)
    lab.drive.write("position_control_gain", 80_000)
    start(lab, 0)
    lab.wait(3.0)


def gentle(lab):
    """Enabled and referenced, with a gentle profile."""
    lab.master.enable()
    lab.master.home(35)
    for name in ("profile_acceleration", "profile_deceleration"):
        lab.drive.write(name, 2_000_000)
    lab.wait(0.01)
    lab.drive.write("motion_profile_type", 3)


def gently(lab, before=lambda lab: None):
    gentle(lab)
    before(lab)
    lab.master.move_to(0.42)
    lab.master.jog(-0.1)
    lab.wait_until(lambda: lab.master.position < 0.122)
    lab.master.jog(0.0)
    lab.wait(0.5)


def no_jump(lab, step=50):
    lab.predict(2)
    lab.master.enable()
    lab.master.home(37)
    lab.drive.write("target_position", lab.drive.read("position_actual_value"))
    lab.master.set_mode(Mode.CYCLIC_SYNC_POSITION)
    lab.wait(0.1)
    for target in range(0, 10_001, step):
        lab.drive.write("target_position", target)
        lab.wait(1e-3)
    lab.wait(0.3)


SOLUTIONS = {
    "11_power": power,
    "12_stop_it": stop_it,
    "13_overvoltage": overvoltage,
    "21_home_to_a_switch": home_to_a_switch,
    "31_find_why_it_trips": find_why_it_trips,
    "32_units": units,
    "41_position_gain": position_gain,
    "51_gently": gently,
    "61_no_jump": no_jump,
}


# ----------------------------------------------------------------- wrong ways


def reach(lab, target_mm, seconds=3.0):
    start(lab, round(target_mm * 1e3))
    lab.wait(seconds)


def after_trip(*writes, then=lambda lab: lab.master.move_to(0.4)):
    """Find-why-it-trips with other remedies."""

    def solve(lab):
        tripped(lab)
        for name, value in writes:
            lab.drive.write(name, value)
        lab.master.reset_fault()
        lab.master.enable()
        then(lab)

    return solve


def by_a_file(before, after, *writes):
    """The parameters come in a file that was saved before."""

    def cheat(lab):
        kept = lab.machine.snapshot()
        for name, value in writes:
            lab.drive.write(name, value)
        content = lab.drive.parameters.export()
        lab.machine.restore(kept)
        before(lab)
        lab.control(0x00)
        assert lab.drive.use_parameters(content) == ""
        after(lab)

    return cheat


def on_another_node(solve):
    """All of it is done, and the frames go to another drive, with another node id."""

    def cheat(lab):
        other = Laboratory(lab.exercise)
        solve(other)
        assert other.report.done
        node = Node(other.drive, 2)
        node.receive(Frame(0, bytes([1, 2])), 0)
        for word in (0x06, 0x07, 0x0F):
            node.receive(Frame(0x202, word.to_bytes(2, "little")), 0)
            lab.wait(0.1)

    return cheat


def stop_by(*controlwords, wait=2.5):
    def solve(lab):
        under_way(lab)
        lab.predict(1)
        lab.control(*controlwords)
        lab.wait(wait)
        lab.drive.write("controlword", 0x02)
        lab.wait(0.5)

    return solve


def powered(*steps):
    """Power with some steps done otherwise: what is sent in each of them."""

    def solve(lab):
        for words in steps:
            if lab.attempt.asks:
                lab.predict(1)
            lab.control(*words)
            lab.wait(0.3)

    return solve


def homed_by(first, second=17, speed=50_000):
    def solve(lab):
        lab.predict(1)
        lab.master.enable()
        lab.master.home(first)
        lab.master.move_to(0.25)
        lab.drive.write("speed_during_search_for_switch", speed)
        lab.master.home(second)

    return solve


def gain_and(*writes, target=0.0):
    def solve(lab):
        lab.predict(1)
        lab.master.enable()
        lab.master.home(37)
        reach(lab, 300)
        for name, value in writes:
            lab.drive.write(name, value)
        reach(lab, target)

    return solve


def power_cycled(solve):
    """Done in part, switched off and on, and done again: nothing that was before may count."""

    def cheat(lab):
        lab.master.enable()
        lab.machine.reset(positions={"x": 0.4})
        lab.wait(0.01)
        solve(lab)

    return cheat


def changed(solve, *writes):
    """A solution on a drive in which something was changed before."""

    def cheat(lab):
        for name, value in writes:
            lab.drive.write(name, value)
        solve(lab)

    return cheat


def fault_stops_it(lab):
    under_way(lab)
    lab.predict(1)
    lab.drive.write("following_error_window", 1)
    lab.wait_until(lambda: lab.drive.state.name in ("FAULT_REACTION_ACTIVE", "FAULT"))
    lab.drive.write("controlword", 0x02)
    lab.wait(0.5)
    lab.control(0x80)
    lab.wait(0.1)


def fault_cuts_the_power(lab):
    powered((0x0F,), (0x06,), (0x07, 0x0F))(lab)
    lab.predict(1)
    supply = lab.drive.read("undervoltage")
    lab.drive.write("undervoltage", 400_000)
    lab.wait(0.1)
    lab.drive.write("undervoltage", supply)
    lab.control(0x02, 0x80)
    lab.wait(0.1)
    lab.control(0x06, 0x07, 0x0F)


def overvoltage_ignored(*writes):
    def cheat(lab):
        lab.master.enable()
        lab.wait(0.02)
        lab.predict(1)
        lab.control(0x00, 0x80)
        for name, value in writes:
            lab.drive.write(name, value)
        lab.control(0x00, 0x80, 0x06, 0x07, 0x0F)

    return cheat


def offset_instead_of_the_move(lab):
    lab.predict(1)
    lab.master.enable()
    lab.master.home(17)
    lab.drive.write("speed_during_search_for_switch", 50_000)
    lab.drive.write("home_offset", 250_000)
    lab.master.home(17)
    lab.master.set_mode(Mode.PROFILE_POSITION)
    lab.wait(0.1)
    lab.master.home(17)


def speed_halved_by_its_unit(lab):
    lab.predict(1)
    lab.master.enable()
    lab.master.home(17)
    lab.master.move_to(0.25)
    lab.control(0x06)
    lab.drive.write("velocity_factor_divisor", 2)
    lab.control(0x07, 0x0F)
    lab.drive.write("speed_during_search_for_switch", 50_000)
    lab.master.home(17)


def method_switched_under_way(lab):
    lab.predict(1)
    lab.master.enable()
    lab.drive.write("homing_method", 17)
    lab.master.set_mode(Mode.HOMING)
    lab.control(0x0F, 0x1F)
    lab.drive.write("homing_method", 37)
    lab.control(0x0F, 0x1F)
    lab.master.move_to(0.25)
    lab.drive.write("speed_during_search_for_switch", 50_000)
    lab.master.home(17)


def offset_near_the_target(lab):
    tripped(lab)
    lab.master.reset_fault()
    lab.drive.write("home_offset", 399_500)
    lab.master.enable()
    lab.master.home(17)
    lab.master.move_to(0.4)


def inched(lab):
    tripped(lab)
    lab.master.reset_fault()
    lab.master.enable()
    at = lab.master.position
    while at < 0.4:
        at = min(at + 0.002, 0.4)
        lab.master.move_to(at)


def while_nobody_looks(lab):
    """The machine advances a little beside the judge, with a wide window each time."""
    tripped(lab)
    lab.master.reset_fault()
    lab.master.enable()
    lab.master.set_mode(Mode.PROFILE_POSITION)
    lab.drive.write("target_position", 400_000)
    lab.control(0x0F)
    lab.drive.write("controlword", 0x1F)
    for _ in range(100):
        lab.drive.write("following_error_window", 1_000_000)
        lab.machine.step(180)
        lab.drive.write("following_error_window", 1000)
        lab.wait(lab.machine.cycle_time)


def time_turned_back(lab):
    kept = lab.machine.snapshot()
    tripped(lab)
    lab.machine.restore(kept)
    lab.master.enable()
    lab.master.home(17)
    lab.master.move_to(0.4)


def offset_is_75(lab):
    lab.master.enable()
    lab.drive.write("home_offset", 75_000)
    lab.master.home(37)
    lab.master.set_mode(Mode.PROFILE_POSITION)
    lab.wait(0.1)
    lab.drive.write("profile_velocity", 40_000)
    reach(lab, 0)


def referenced_on_the_way_back(lab):
    lab.master.enable()
    lab.master.home(37)
    reach(lab, 75)
    lab.drive.write("profile_velocity", 40_000)
    start(lab, 0)
    lab.wait(0.5)
    lab.control(0x10F)
    lab.wait(0.2)
    lab.master.home(37)
    lab.wait(0.1)


def jogged_back(lab):
    lab.master.enable()
    lab.master.home(37)
    reach(lab, 75)
    lab.drive.write("profile_velocity", 40_000)
    lab.master.jog(-0.04)
    lab.wait_until(lambda: lab.master.position < 0.0001)
    lab.master.jog(0.0)
    lab.wait(0.3)


def raised_and_lowered(before=(), after=(), move=lambda lab: reach(lab, 0)):
    """The gain is high for an instant only."""

    def cheat(lab):
        lab.predict(1)
        lab.master.enable()
        lab.master.home(37)
        for name, value in before:
            lab.drive.write(name, value)
        reach(lab, 300)
        lab.drive.write("position_control_gain", 80_000)
        lab.control(0x06)  # units change without power
        for name, value in (("position_control_gain", 15_000), *after):
            lab.drive.write(name, value)
        lab.control(0x07, 0x0F)
        move(lab)

    return cheat


def by_velocity(lab):
    lab.master.jog(-0.4)
    lab.wait_until(lambda: lab.master.position < 0.008)
    lab.master.jog(0.0)
    lab.wait(0.3)


def last_part_in_csp(lab):
    gentle(lab)
    start(lab, 420_000)
    lab.wait_until(lambda: lab.master.position > 0.4)
    follow(lab, 420_000)
    lab.master.jog(-0.1)
    lab.wait_until(lambda: lab.master.position < 0.122)
    lab.master.jog(0.0)
    lab.wait(0.5)


def follow(lab, target, step=50):
    """Lead the axis to a target in csp (drive units)."""
    lab.drive.write("target_position", lab.drive.read("position_actual_value"))
    lab.master.set_mode(Mode.CYCLIC_SYNC_POSITION)
    at = lab.drive.read("position_actual_value")
    while at != target:
        at += max(-step, min(step, target - at))
        lab.drive.write("target_position", at)
        lab.wait(1e-3)
    lab.wait(0.2)


def instead_of_the_way_back(act):
    """A little of the way back by jogging, the rest of it by something else."""

    def cheat(lab):
        gently_there(lab)
        lab.master.jog(-0.1)
        lab.wait(0.3)
        lab.master.jog(0.0)
        lab.wait(0.3)
        act(lab)
        lab.master.jog(0.0)
        lab.wait(0.3)

    return cheat


def gently_there(lab):
    """The exercise up to its way back."""
    gentle(lab)
    lab.master.move_to(0.42)


def at_once(*writes):
    """One large step of 607Ah, which the drive is made to take slowly."""

    def cheat(lab):
        lab.predict(2)
        lab.master.enable()
        lab.master.home(37)
        lab.drive.write("target_position", lab.drive.read("position_actual_value"))
        lab.master.set_mode(Mode.CYCLIC_SYNC_POSITION)
        lab.wait(0.1)
        for name, value in writes:
            lab.drive.write(name, value)
        lab.drive.write("target_position", 10_000)
        lab.wait(2.0)

    return cheat


WRONG = {
    "11_power": {
        "disable operation, and then the quick stop": powered(
            (0x0F,), (0x06,), (0x07, 0x0F), (0x07, 0x02), (0x06, 0x07, 0x0F)),
        "the quick stop is another one": changed(power, ("quick_stop_option_code", 0)),
        "another node": on_another_node(power),
        "a fault cuts the power": fault_cuts_the_power,
        "enabled properly instead of refused": powered((0x06, 0x07, 0x0F)),
        "000Fh from Ready to switch on": powered((0x0F,), (0x06,), (0x0F,)),
        "quick stop by 0000h": powered((0x0F,), (0x06,), (0x07, 0x0F), (0x00,), (0x06, 0x07, 0x0F)),
        "quick stop by shutdown": powered((0x0F,), (0x06,), (0x07, 0x0F), (0x06,), (0x0F,)),
        "power off and on": power_cycled(power),
        "nothing is sent": lambda lab: lab.wait(1.0),
    },
    "12_stop_it": {
        "another quick stop from a file": by_a_file(
            lambda lab: None, stop_it, ("quick_stop_option_code", 0)),
        "the quick stop lets it coast": changed(stop_it, ("quick_stop_option_code", 0)),
        "the quick stop on another ramp": changed(stop_it, ("quick_stop_option_code", 1)),
        "a fault stops it": fault_stops_it,
        "any position is at rest": changed(stop_by(0x11F), ("velocity_threshold", 65_535)),
        "disable voltage": stop_by(0x00),
        "shutdown": stop_by(0x06),
        "switch on": stop_by(0x07),
        "halt, and the quick stop at rest": stop_by(0x11F),
        "it arrives first": stop_by(0x0F, wait=5.0),
        "another reference": lambda lab: under_way(lab, 35),
        "no prediction": lambda lab: (under_way(lab), lab.control(0x02), lab.wait(1.0)),
    },
    "13_overvoltage": {
        "more voltage is allowed": overvoltage_ignored(("overvoltage", 900_000)),
        "more voltage is allowed from the start": changed(
            overvoltage_ignored(), ("overvoltage", 900_000)),
        "no reset tried": lambda lab: (lab.master.enable(), lab.wait(0.1), lab.predict(1),
                                       lab.drive.clear_injected(), lab.control(0x80, 6, 7, 15)),
        "bit 7 held": lambda lab: (lab.control(0x06, 0x07, 0x8F), lab.wait(0.2), lab.predict(1),
                                   lab.drive.clear_injected(), lab.control(0x86, 0x87, 0x8F)),
        "never enabled": lambda lab: (lab.predict(1) if lab.attempt.asks else None, lab.wait(1.0)),
        "power off and on": power_cycled(overvoltage),
        "no prediction": lambda lab: (lab.master.enable(), lab.wait(0.02), lab.control(0, 0x80),
                                      lab.drive.clear_injected(), lab.control(0, 128, 6, 7, 15)),
    },
    "21_home_to_a_switch": {
        "a home offset instead of the move": offset_instead_of_the_move,
        "half the speed by another unit": speed_halved_by_its_unit,
        "another method under way": method_switched_under_way,
        "method 35": homed_by(35),
        "method 37": homed_by(37),
        "method 18": homed_by(18),
        "the second by 35": homed_by(17, 35),
        "as fast as before": homed_by(17, 17, 100_000),
        "power off and on": power_cycled(home_to_a_switch),
    },
    "31_find_why_it_trips": {
        "a home offset near the target": offset_near_the_target,
        "another reaction": after_trip(("reaction_to_following_error", 0)),
        "another reaction before": changed(find_why_it_trips, ("reaction_to_following_error", 1)),
        "inched": inched,
        "while nobody looks": while_nobody_looks,
        "time turned back": time_turned_back,
        "a wider window from a file": by_a_file(
            tripped, lambda lab: (lab.control(0x00, 0x80), lab.master.enable(),
                                  lab.master.move_to(0.4)),
            ("following_error_window", 1_000_000)),
        "a wider window": after_trip(("following_error_window", 1_000_000)),
        "the window off": after_trip(("following_error_window", 0xFFFFFFFF)),
        "a longer time-out": after_trip(("following_error_time_out", 60_000)),
        "jogged there": after_trip(then=lambda lab: (lab.master.jog(0.05), lab.wait(8.0))),
        "wider, moved, and narrow again": after_trip(
            ("following_error_window", 1_000_000),
            then=lambda lab: (lab.master.move_to(0.4),
                              lab.drive.write("following_error_window", 1000), lab.wait(0.1)),
        ),
        "raised before it tripped": lambda lab: (
            lab.master.enable(), lab.master.home(17), lab.drive.write("max_torque", 3000),
            lab.master.move_to(0.4),
        ),
        "referenced by another method": lambda lab: (lab.master.enable(), lab.master.home(35)),
        "power off and on": power_cycled(find_why_it_trips),
    },
    "32_units": {
        "the home offset is 75": offset_is_75,
        "the gear": changed(units, ("gear_motor_revolutions", 2)),
        "the feed": changed(units, ("feed", 30_000)),
        "the other direction": changed(units, ("polarity", 0x80)),
        "always at rest": changed(units, ("velocity_threshold", 65_535)),
        "referenced on the way back": referenced_on_the_way_back,
        "jogged back": jogged_back,
        "75": lambda lab: (lab.master.enable(), lab.master.home(37), reach(lab, 0.075)),
        "as fast as before": lambda lab: (lab.master.enable(), lab.master.home(37),
                                          reach(lab, 75), reach(lab, 0)),
        "set after the start": lambda lab: (
            lab.master.enable(), lab.master.home(37), reach(lab, 75), start(lab, 0), lab.wait(0.1),
            lab.drive.write("profile_velocity", 40_000), lab.wait(3.0)),
        "too slow": lambda lab: (
            lab.master.enable(), lab.master.home(37), reach(lab, 75),
            lab.drive.write("profile_velocity", 20_000), reach(lab, 0, 5.0)),
        "other units": lambda lab: (
            lab.master.enable(), lab.master.home(37), lab.drive.write("feed", 60), reach(lab, 75)),
    },
    "41_position_gain": {
        "high for an instant, and by velocity": raised_and_lowered(move=by_velocity),
        "high for an instant, with feed-forward from before": raised_and_lowered(
            before=(("velocity_feed_forward", 1000),)),
        "high for an instant, in other units": raised_and_lowered(after=(("feed", 6000),)),
        "slower": gain_and(("profile_velocity", 50_000)),
        "gentler": gain_and(("position_control_gain", 40_000), ("profile_acceleration", 100_000)),
        "feed-forward": gain_and(("velocity_feed_forward", 1000)),
        "too little": gain_and(("position_control_gain", 30_000)),
        "not moved": gain_and(("position_control_gain", 80_000), target=300),
        "another velocity loop": gain_and(
            ("position_control_gain", 80_000), ("velocity_control_time", 4000)),
    },
    "51_gently": {
        "a jerk without limit from a file": by_a_file(
            lambda lab: None, gently, *((f"profile_jerk_{n}", 4_000_000_000) for n in (1, 2))),
        "a jerk without limit": lambda lab: gently(lab, lambda lab: [
            lab.drive.write(f"profile_jerk_{n}", 4_000_000_000) for n in (1, 2, 3, 4)]),
        "the last part in csp": last_part_in_csp,
        "led back in csp": instead_of_the_way_back(lambda lab: follow(lab, 120_000)),
        "a reference instead of the way back": instead_of_the_way_back(
            lambda lab: lab.master.home(35)
        ),
        "jerk-limited after the move": lambda lab: (
            lab.master.enable(), lab.master.home(35),
            lab.drive.write("profile_acceleration", 2_000_000),
            lab.drive.write("profile_deceleration", 2_000_000), lab.wait(0.01),
            lab.master.move_to(0.42), lab.drive.write("motion_profile_type", 3), lab.wait(0.1)),
        "jerk-limited while it moves": lambda lab: (
            lab.master.enable(), lab.master.home(35),
            lab.drive.write("profile_acceleration", 2_000_000),
            lab.drive.write("profile_deceleration", 2_000_000), lab.wait(0.01),
            start(lab, 420_000), lab.wait(0.1), lab.drive.write("motion_profile_type", 3),
            lab.wait(2.0)),
        "hard again for the move": lambda lab: gently(
            lab, lambda lab: lab.drive.write("profile_acceleration", 10_000_000)),
        "homed by travelling": lambda lab: (lab.master.enable(), lab.master.home(17)),
        "back by a profile move": lambda lab: (
            lab.master.enable(), lab.master.home(35),
            lab.drive.write("profile_acceleration", 2_000_000),
            lab.drive.write("profile_deceleration", 2_000_000), lab.wait(0.01),
            lab.drive.write("motion_profile_type", 3), lab.master.move_to(0.42),
            lab.master.move_to(0.12)),
    },
    "61_no_jump": {
        "a soft loop": at_once(
            ("following_error_window", 1_000_000), ("position_control_gain", 3000)),
        "a slow motor": at_once(("following_error_window", 1_000_000), ("max_motor_speed", 40)),
        "a drive that interpolates": at_once(
            ("following_error_window", 1_000_000), ("interpolation_time_period_value", 200)),
        "a weak motor": at_once(("following_error_window", 1_000_000), ("max_torque", 30)),
        "the target far away": lambda lab: (
            lab.predict(2), lab.master.enable(), lab.master.home(37),
            lab.drive.write("target_position", 50_000),
            lab.drive.write("modes_of_operation", 8), lab.wait(1.0)),
        "steps too large": lambda lab: no_jump(lab, 500),
        "one step": lambda lab: no_jump(lab, 10_000),
        "a profile move": lambda lab: (no_jump(lab, 20_000), reach(lab, 10)),
        "not enabled": lambda lab: (
            lab.predict(2), lab.drive.write("modes_of_operation", 8), lab.wait(1.0)),
        "no prediction": lambda lab: (
            lab.master.enable(), lab.master.home(37),
            lab.drive.write("target_position", lab.drive.read("position_actual_value")),
            lab.master.set_mode(Mode.CYCLIC_SYNC_POSITION), lab.wait(0.1)),
    },
}


def test_every_exercise_has_a_solution_and_at_least_five_wrong_ways():
    assert [*SOLUTIONS] == [*WRONG] == NAMES
    assert all(len(ways) >= 5 for ways in WRONG.values())
    assert sum(map(len, WRONG.values())) >= 40


@pytest.mark.parametrize("name", NAMES)
def test_the_solution_passes(name):
    lab = begin(name)
    SOLUTIONS[name](lab)
    report = lab.report
    assert (report.wrong, report.done) == ("", True), f"step {report.step + 1}"
    assert all(report.predictions)


@pytest.mark.parametrize(("name", "way"), [(n, way) for n, ways in WRONG.items() for way in ways])
def test_a_wrong_way_does_not_pass(name, way):
    lab = begin(name)
    with contextlib.suppress(ServoError, SdoAbort, ValueError):
        WRONG[name][way](lab)
    assert not lab.report.done, way


def test_exercises_in_another_order_leave_nothing_to_one_another():
    for name in reversed(NAMES):
        lab = begin(name)
        SOLUTIONS[name](lab)
        assert lab.report.done, name


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second"), [*permutations(NAMES, 2)])
def test_an_exercise_leaves_nothing_to_the_one_after_it(first, second):
    lab = begin(first)
    SOLUTIONS[first](lab)
    lab = begin(second)
    SOLUTIONS[second](lab)
    assert lab.report.done


def test_a_pupils_own_writes_are_lost_where_the_next_exercise_begins_by_a_power_cycle():
    """CiA 301: what is not stored is lost by a reset of the node."""
    lab = begin("31_find_why_it_trips")
    delivered = lab.drive.parameters.kept["6072:00"]
    lab.drive.write("max_torque", 100)
    Node(lab.drive).receive(Frame(0, bytes([0x81, lab.drive.node_id])), 0)
    assert lab.drive.read("max_torque") == delivered


def test_what_is_said_names_the_wrong_way():
    lab = begin("31_find_why_it_trips")
    WRONG["31_find_why_it_trips"]["a wider window"](lab)
    assert "that hides the cause" in lab.report.wrong


def test_hints_are_given_one_by_one_and_counted():
    lab = begin("12_stop_it")
    first, second, third = (lab.attempt.hint() for _ in range(3))
    assert first != second == third
    assert lab.report.hints == 2


@pytest.mark.parametrize("name", NAMES)
def test_numbers_in_hints_do_not_trip_the_drive_again(name):
    """A value that a hint names is one with which the exercise passes."""
    given = {"31_find_why_it_trips": (("max_torque", 3000), ("profile_acceleration", 500_000)),
             "41_position_gain": (("position_control_gain", 80_000),)}
    for parameter, value in given.get(name, ()):
        assert any(str(value) in hint for step in files.named(name).steps for hint in step.hints)
        lab = begin(name)
        if name == "41_position_gain":
            gain_and((parameter, value))(lab)
        else:
            after_trip((parameter, value))(lab)
        assert lab.report.done, (parameter, value, lab.report)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "'step' is missing"),
        ("title='a'\nstep=[]", "it has no step"),
        ("title='a'\n[[step]]\ntext='b'", "step 1: 'goal' is missing"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[]", "give at least one condition"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[{state='ON'}]", "state = 'ON'"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[{stat='FAULT'}]", "did you mean state"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[{position=[2,1]}]", "not a range of two numbers"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[{homed=1}]", "use true or false"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[{unless={state='ON'}}]", "unless: state = 'ON'"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[{homed=true}]\nhint='c'", "did you mean hints"),
        ("title='a'\n[begin]\ndisturb={drag=1}\n[[step]]\ntext='b'\ngoal=[{homed=true}]", "drag"),
        ("title='a'\n[[step]]\ntext='b'\ngoal=[{homed=true}]\n[step.predict]\nquestion='c'\n"
         "options=['d','e']\nanswer=2\nwhy='f'", "answer = 2 is out of range 0..1"),
        ("title = ", "exercise"),
    ],
)
def test_an_exercise_that_cannot_be_right_is_refused_with_its_file(tmp_path, text, said):
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=said) as error:
        files.load(file)
    assert str(file) in str(error.value)
