"""Touch probe and latch store edges: a level that was there before is none."""

import pytest

from conftest import Shaft
from servogym.drive.model.model import load, model_names

MODELS = model_names()
POSITIVE, NEGATIVE = 1, 2


def arm(shaft, edges=POSITIVE | NEGATIVE, probe=0):
    """Let the model's own word wait for edges of a probe."""
    if shaft.axis.latch_words:
        shaft.axis.od.latch_control = edges << 2 * probe
    else:
        shaft.axis.od.touch_probe_function = (1 | edges << 4) << 8 * probe
    shaft.step(2)


def disarm(shaft):
    shaft.axis.od.latch_control = shaft.axis.od.touch_probe_function = 0
    shaft.step(2)


def stored(shaft, probe=0):
    return int(shaft.axis.probe_stored) >> 2 * probe & 3


@pytest.mark.parametrize("probe", [0, 1])
@pytest.mark.parametrize("model", MODELS)
def test_an_input_that_is_high_already_is_no_edge(model, probe):
    shaft = Shaft(model)
    disarm(shaft)
    shaft.axis.touch_probe[probe] = 1
    shaft.step(2)
    arm(shaft, probe=probe)
    shaft.step(10)
    assert stored(shaft, probe) == 0
    shaft.axis.touch_probe[probe] = 0
    shaft.step(2)
    assert stored(shaft, probe) == NEGATIVE
    shaft.axis.touch_probe[probe] = 1
    shaft.step(2)
    assert stored(shaft, probe) == POSITIVE | NEGATIVE


@pytest.mark.parametrize("model", MODELS)
def test_an_input_that_fell_while_it_was_off_is_no_edge(model):
    shaft = Shaft(model)
    shaft.axis.touch_probe[0] = 1
    arm(shaft)
    disarm(shaft)
    shaft.axis.touch_probe[0] = 0
    shaft.step(2)
    arm(shaft)
    shaft.step(10)
    assert stored(shaft) == 0


@pytest.mark.parametrize("model", MODELS)
def test_an_input_that_is_high_at_power_on_is_no_edge(model):
    shaft = Shaft(model)
    shaft.drive.reset()
    shaft.axis.touch_probe[:] = 1
    shaft.step(10)
    assert shaft.axis.probe_stored == 0
    assert shaft.axis.od.sample_status == 0


@pytest.mark.parametrize(
    ("inputs", "bits"), [((0, 0), 0), ((1, 0), 0x8000), ((0, 1), 0x4000), ((1, 1), 0xC000)]
)
@pytest.mark.parametrize("enabled", [False, True])
def test_the_latch_status_shows_the_inputs_at_all_times(inputs, bits, enabled):
    """Kollmorgen AKD 5.12: bits 12-15 are digital inputs 4 to 1."""
    shaft = Shaft("kollmorgen_akd")
    if enabled:
        arm(shaft)
    shaft.axis.touch_probe[:] = inputs
    shaft.step(2)
    assert shaft.drive.read(0x20A5) & 0xF000 == bits
    assert load("kollmorgen_akd").quirk("latch_words")
