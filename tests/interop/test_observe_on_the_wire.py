"""`servogym observe --ethercat` on the wire: pysoem scans, our telegrams ask."""

from wire import on_the_wire

from servogym.drive.ethercat.observe import of_model
from servogym.drive.observation import compare

SERVED = ("--drive", "generic", "--clock", "real")


def test_a_served_slave_says_on_the_wire_what_it_says_in_memory():
    found = on_the_wire("pysoem_observe", "observed", *SERVED)
    assert found["read_only"] == ""
    assert found["bus"] == "ethercat"
    differences = compare(found, of_model("generic"))
    # values and statuswords are those of a drive that is commissioned, and under voltage
    told = [str(d) for d in differences if d.what in ("answer", "object", "length", "write")]
    assert [line for line in told if not line.startswith("controlword")] == []
    assert not any("not_restored" in one for one in found["objects"].values())


def test_a_segment_that_another_master_runs_is_left_alone():
    said = on_the_wire("pysoem_observe", "while_in_op", "--drive", "kollmorgen_akd")
    assert "slave 0 is in OPERATIONAL, so a master runs it" in said["error"]
    assert said["state"] == 8
    assert said["wrong"] == 0


def test_a_drive_that_is_enabled_by_its_mailbox_is_read_as_it_stands():
    said = on_the_wire("pysoem_observe", "while_enabled", *SERVED)
    assert said["read_only"] == "slave 0 is in OPERATION_ENABLED"
    assert said["before"] == said["after"] == 0x27
    assert said["state"] == 2
    assert said["written"] == []
