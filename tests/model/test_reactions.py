"""2100h: default, least reaction and choice belong to each fault, to main and sub-number.

Festo CMMP-AS 5.18, B.1-B.3; Metronix ARS 2000 5.5.2, 6.18. The oracle is what the manuals print, in
the columns `reaction_default` and `reactions_possible` of faults.csv, and B.1 for the words.
"""

import csv
from collections import Counter

import pytest

from conftest import Shaft
from servogym.drive.drive import Drive
from servogym.drive.kernel.faults import Cause, Reaction
from servogym.drive.kernel.words import State
from servogym.drive.model.model import load, model_names
from servogym.drive.objects import reactions

CHOOSE = [name for name in model_names() if "error_reaction_code" in load(name).names]
PRINTED = {  # words of the manuals
    "PS off": Reaction.DISABLE, "QStop": Reaction.QUICK_STOP, "Warn": Reaction.WARNING,
    "WARNING (0x6510:37 default 0)": Reaction.WARNING,
    "WARNING (0x6510:38 default 0)": Reaction.WARNING,
    "NO ACTION (0x6510:22 default 0)": Reaction.IGNORE,
    "immediate switch-off": Reaction.DISABLE,
}
EITHER_WAY = (  # an end of the way and the other one
    (Cause.NEGATIVE_BLOCKED, Cause.POSITIVE_BLOCKED),
    (Cause.SOFTWARE_LIMIT_MIN, Cause.SOFTWARE_LIMIT_MAX),
    (Cause.TARGET_BEHIND_MIN, Cause.TARGET_BEHIND_MAX),
)


def printed(name):
    """Rows of the manual's list that the model has, in the order of its faults."""
    model = load(name)
    folder = model.folder
    while not (folder / "faults.csv").exists():
        folder = load(str(folder)).based_on
    with (folder / "faults.csv").open(encoding="utf-8", newline="") as file:
        rows = [*csv.DictReader(file)]
    own = [row for row in rows if row.get("variant", "") in ("", VARIANT.get(name, ""))]
    assert len(own) == len(model.faults)
    return zip(own, model.faults, strict=True)


VARIANT = {"festo_cmmp_as": "M3", "festo_cmmp_as_m0": "M0", "festo_cmms": "M0", "festo_cmmd": "M0"}


@pytest.mark.parametrize("name", CHOOSE)
def test_each_fault_reacts_as_its_manual_prints(name):
    wrong = [
        (fault.name, row["reaction_default"], fault.reaction.name)
        for row, fault in printed(name)
        if row["reaction_default"] and PRINTED[row["reaction_default"]] != fault.reaction
    ]
    assert not wrong


@pytest.mark.parametrize("name", CHOOSE)
def test_a_master_chooses_what_its_manual_lets_it_choose_for_each_sub_number(name):
    """What is printed without a choice is the least reaction (5.18); "configurable" has none."""
    drive = Drive(name)
    for main in sorted({fault.main for fault in drive.model.faults if fault.main}):
        drive.write("error_number", main)
        drive.write("error_reaction_code", 0)
    for row, fault in printed(name):
        choice = row["reactions_possible"] not in ("", "not changeable")
        if not fault.main or not (choice or row["reaction_default"]):
            continue  # the manual leaves it open
        least = Reaction.IGNORE if choice else PRINTED[row["reaction_default"]]
        assert reactions.reaction_to(drive, fault) == least, (fault.name, fault.meaning)


@pytest.mark.parametrize("name", CHOOSE)
def test_a_variant_has_the_faults_of_its_own_hardware(name):
    """B.3: "only M3" are slots and safety module, "only M0" the STO circuit of the housing."""
    numbers = Drive(name).injectable
    ethercat = [n for n in numbers if n.startswith(("62-", "63-"))]
    assert bool(ethercat) == ("ethercat" in load(name).buses)


@pytest.mark.parametrize("name", model_names())
def test_what_is_told_at_one_end_of_the_way_is_told_at_the_other(name):
    told = Counter(fault.cause for fault in load(name).faults)
    assert all(bool(told[one]) == bool(told[other]) for one, other in EITHER_WAY)


@pytest.mark.parametrize("number", ["03-0", "06-0", "32-9"])
def test_a_fault_that_must_act_cannot_be_switched_off(number):
    shaft = Shaft("festo_cmmp_as").enable(3)
    shaft.write(error_number=int(number[:2]), error_reaction_code=0)
    shaft.drive.inject(number)
    shaft.step(3)
    assert shaft.drive.fault
    assert shaft.drive.state in (State.FAULT_REACTION_ACTIVE, State.FAULT)


@pytest.mark.parametrize("number", [f"08-{sub}" for sub in range(10)])
def test_encoder_faults_can_be_chosen(number):
    drive = Drive("festo_cmmp_as")
    for code, reaction in ((3, Reaction.WARNING), (8, Reaction.DISABLE)):
        drive.write("error_number", 8)
        drive.write("error_reaction_code", code)
        assert drive.read("error_reaction_code") == code
        fault = next(f for f in drive.model.faults if f.name == number)
        assert reactions.reaction_to(drive, fault) == reaction


@pytest.mark.parametrize(
    ("main", "switch", "off"),
    [
        (2, "enable_dc_link_undervoltage_error", 3),
        (31, "iit_error_enable", 3),
        (17, "position_error_switch_off_limit", 0),
    ],
)
@pytest.mark.parametrize("name", CHOOSE)
def test_a_switch_of_6510h_and_2100h_are_one_setting(name, main, switch, off):
    """At power-on, after a write of either, and after both ways of keeping it."""
    drive = Drive(name)
    drive.write("error_number", main)
    on = 8 if main == 17 else 5
    assert (drive.read(switch), drive.read("error_reaction_code")) == (0, off)
    drive.write(switch, 1)
    assert drive.read("error_reaction_code") == on
    drive.write("error_reaction_code", 3)
    assert drive.read(switch) == 0
    drive.write("error_reaction_code", on)
    drive.write(0x1010, 1, 0x65766173)
    for keep in (True, False):
        drive.reset(keep_parameters=keep)
        drive.write("error_number", main)
        assert (drive.read(switch), drive.read("error_reaction_code")) == (1, on)
        cause = next(f.cause for f in drive.model.faults if f.main == main and not f.sub)
        acts = Reaction(int(drive.axis.od.fault_reaction[cause]))
        assert acts in (Reaction.QUICK_STOP, Reaction.DISABLE)


def test_a_switch_leaves_the_other_faults_of_its_number():
    """6510h:38h acts on 31-0 (5.5), not on the servo drive's own I²t, 31-1."""
    drive = Drive("festo_cmmp_as")
    others = [f for f in drive.model.faults if f.main == 31 and f.sub]
    before = [reactions.reaction_to(drive, fault) for fault in others]
    drive.write("iit_error_enable", 0)
    assert [reactions.reaction_to(drive, fault) for fault in others] == before


@pytest.mark.parametrize("way", [-1, 1])
def test_the_software_limit_is_told_at_both_ends(way):
    """Metronix 5.5.2: "8612 E 40 x"."""
    shaft = Shaft("metronix_ars2000")
    shaft.enable(6)
    shaft.write(homing_method=35)
    shaft.control(0x1F, 20)
    shaft.control(0x0F, 5)
    shaft.write(min_position_limit=-65536, max_position_limit=65536)
    shaft.write(modes_of_operation=1, target_position=way * 65536 * 3, profile_velocity=2000)
    shaft.control(0x0F, 3)
    shaft.control(0x1F, 3)
    shaft.step(4000)
    assert shaft.axis.event_code.tolist().count(0x8612) == 1, shaft.axis.event_code


def test_an_older_parameter_file_names_main_numbers():
    drive = Drive("festo_cmmp_as")
    drive.parameters.restore({"reaction:31": 5})
    assert drive.read("iit_error_enable") == 1
