"""A slave goes on from a snapshot bit by bit: AL state, transfers, telegrams that wait."""

import hashlib
import json
import struct

import numpy as np
import pytest
from wired import O, P, S, Wired

from servogym.drive.ethercat.mailbox import Kind
from servogym.envs import linear_axis


def frames(slave):
    """What comes back of some SDO and process data."""
    answers = []
    for index, subindex in ((0x1018, 2), (0x6041, 0), (0x5FFF, 0), (0x1C32, 1)):
        slave.send(Kind.COE, struct.pack("<HBHBI", 0x2000, 0x40, index, subindex, 0), counter=1)
        answers.append(slave.fetch())
        answers.append(slave.cycle(bytes(slave.drive.rpdo_size), 3))
    return answers


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd"])
def test_a_segment_in_operational_goes_on_from_its_snapshot(model):
    slave = Wired(model).to(P, S, O)
    slave.cycle(bytes(slave.drive.rpdo_size), 10)
    snapshot = slave.segment.snapshot()
    wanted = frames(slave)
    slave.segment.restore(snapshot)
    assert frames(slave) == wanted
    other = Wired(model)
    other.segment.restore(snapshot)
    assert other.slave.state == O
    assert frames(other) == wanted


def test_a_transfer_in_segments_goes_on_from_its_snapshot():
    slave = Wired("generic", mailbox=(34, 34)).to(P)
    request = struct.pack("<HBHBI", 0x2000, 0x40, 0x1008, 0, 0)
    slave.ask(Kind.COE, request)
    snapshot = slave.segment.snapshot()
    rest = slave.segment_request(0x60)
    slave.segment.restore(snapshot)
    assert slave.segment_request(0x60) == rest
    other = Wired("generic", mailbox=(34, 34))
    other.segment.restore(snapshot)
    assert other.segment_request(0x60) == rest


def test_an_emergency_that_waits_and_a_file_that_is_read_are_in_the_snapshot():
    slave = Wired("generic").to(P)
    slave.send(Kind.COE, struct.pack("<HBHBI", 0x2000, 0x40, 0x1018, 2, 0))
    slave.drive.inject("overvoltage")
    slave.cycle(cycles=5)
    snapshot = slave.segment.snapshot()
    wanted = [slave.fetch() for _ in range(3)]
    assert wanted[1][1][:4] == bytes.fromhex("00101032")
    other = Wired("generic")
    other.segment.restore(snapshot)
    assert [other.fetch() for _ in range(3)] == wanted
    slave = Wired("generic").to(P)
    slave.ask(Kind.FOE, struct.pack("<BxI", 1, 0) + b"parameters")
    snapshot = slave.segment.snapshot()
    acknowledge = struct.pack("<BxI", 4, 1)
    wanted = slave.ask(Kind.FOE, acknowledge)
    other = Wired("generic")
    other.segment.restore(snapshot)
    assert other.ask(Kind.FOE, acknowledge) == wanted


def test_a_damaged_snapshot_of_a_slave_is_refused():
    slave = Wired("generic").to(P)
    for damaged in (b"", b"(1, 2)", b"\xff", b"__import__('os')"):
        with pytest.raises(ValueError, match="this is not a snapshot"):
            slave.slave.restore(damaged)


@pytest.fixture(scope="module")
def kept():
    """What has a snapshot, in a state worth keeping."""
    slave = Wired("generic").to(P, S, O)
    slave.cycle(bytes(slave.drive.rpdo_size), 10)
    machine = linear_axis("generic")
    machine.step(10)
    return {
        "segment": slave.segment, "slave": slave.slave, "drive": slave.drive, "machine": machine,
    }


def damaged(snapshot, seed):
    """One bit, one byte, a part more or less, or two parts that have changed places."""
    random = np.random.default_rng(seed)
    at, other = sorted(random.integers(0, len(snapshot), 2))
    data = bytearray(snapshot)
    kind = seed % 5
    if kind == 0:
        data[at] ^= 1 << int(random.integers(8))
    elif kind == 1:
        data[at] = data[at] + int(random.integers(1, 256)) & 0xFF
    elif kind == 2:
        del data[at : at + 1 + int(random.integers(40))]
    elif kind == 3:
        data[at:at] = random.bytes(1 + int(random.integers(40)))
    else:
        size = min(8, other - at, len(data) - other)
        data[at : at + size], data[other : other + size] = (
            data[other : other + size], data[at : at + size],
        )
    return bytes(data)


@pytest.mark.parametrize("name", ["segment", "slave", "drive", "machine"])
def test_no_damaged_snapshot_is_taken_and_none_changes_anything(kept, name):
    owner = kept[name]
    snapshot = owner.snapshot()
    for seed in range(400):
        if (data := damaged(snapshot, seed)) != snapshot:
            with pytest.raises(ValueError, match="snapshot"):
                owner.restore(data)
    assert owner.snapshot() == snapshot


@pytest.mark.parametrize("nothing", [None, 7, "text"])
@pytest.mark.parametrize("name", ["segment", "slave", "drive", "machine"])
def test_what_is_no_snapshot_at_all_is_refused(kept, name, nothing):
    with pytest.raises(ValueError, match="is not a snapshot: give the bytes of one"):
        kept[name].restore(nothing)


def test_a_snapshot_of_another_segment_is_refused():
    with pytest.raises(ValueError, match="another segment: its slaves"):
        Wired("kollmorgen_akd").segment.restore(Wired("generic").segment.snapshot())


def sealed_again(snapshot, change):
    """The snapshot with another body and the checksum of that."""
    title, _, body = snapshot.partition(b"\n")
    head, _, data = body.partition(b"\n")
    head, data = change(json.loads(head), data)
    body = (head if isinstance(head, bytes) else json.dumps(head).encode()) + b"\n" + data
    mark, version, _ = title.split(b" ")
    return b" ".join((mark, version, hashlib.sha256(body).hexdigest().encode())) + b"\n" + body


CHANGES = {
    "no state": lambda head, data: ({k: v for k, v in head.items() if k != "state"}, data),
    "no sizes": lambda head, data: ({k: v for k, v in head.items() if k != "sizes"}, data),
    "an empty state": lambda head, data: (head | {"state": {}}, data),
    "a key too many": lambda head, data: (head | {"state": head["state"] | {"more": 1}}, data),
    "an identity that is a list": lambda head, data: (head | {"identity": [1]}, data),
    "no JSON": lambda head, data: (b"junk", data),
    "a list": lambda head, data: ([], data),
    "deep": lambda head, data: (b"[" * 100_000, data),
    "cut": lambda head, data: (head, data[:-9]),
    "longer": lambda head, data: (head, data + b"x"),
    "sizes that are texts": lambda head, data: (head | {"sizes": ["a"]}, data),
    "negative sizes": lambda head, data: (
        head | {"sizes": [-1, *head["sizes"][1:-1], head["sizes"][-1] + head["sizes"][0] + 1]},
        data,
    ),
    "a part less": lambda head, data: (
        head | {"sizes": head["sizes"][:-1]}, data[: sum(head["sizes"][:-1])]),
    "a part more": lambda head, data: (head | {"sizes": [*head["sizes"], 0]}, data),
    "bytes of one part in another": lambda head, data: (
        head | {"sizes": [head["sizes"][0] + 8, *head["sizes"][1:-1], head["sizes"][-1] - 8]},
        data,
    ),
}


@pytest.mark.parametrize("of", ["machine", "drive", "segment"])
def test_a_snapshot_of_another_form_is_refused_in_words_though_its_checksum_fits(of):
    machine = linear_axis()
    thing = {
        "machine": machine, "drive": machine.drives["x"], "segment": Wired("generic").segment,
    }[of]
    own = thing.snapshot()
    for name, change in CHANGES.items():
        with pytest.raises(ValueError, match="snapshot") as refused:
            thing.restore(sealed_again(own, change))
        assert "\n" not in str(refused.value), name
        assert thing.snapshot() == own, name
