"""What an unmodified KickCAT does on the wire, through its Python binding."""

import kickcat
from kickcat.mailbox.request import MessageStatus

PORT, SECOND = "vb", "vb2"


def reach_op(cycles=1000, second=SECOND):
    """INIT to OP as the examples of KickCAT have it, then cycles; -> what was seen."""
    link = kickcat.create_link(PORT, second)
    # while it looks for slaves it waits as long for each answer of a port that it does not have
    link.set_timeout(1.0 if second else 0.02)
    bus = kickcat.Bus(link)
    bus.init(0.5)
    bus.create_mapping()
    link.set_timeout(1.0)
    drives = bus.slaves()
    bus.request_state(kickcat.State.SAFE_OP)
    bus.wait_for_state(kickcat.State.SAFE_OP, 5.0)
    for drive in drives:
        drive.set_output_bytes(bytes(drive.output_size))
    bus.process_data_no_check()
    bus.request_state(kickcat.State.OPERATIONAL)
    bus.wait_for_state(kickcat.State.OPERATIONAL, 5.0, bus.process_data_no_check)
    for _ in range(cycles):
        bus.process_data()  # raises where a working counter is wrong
    name = drives[0].mailbox.read_sdo(0x1008, 0, False)
    while name.status() == MessageStatus.RUNNING:
        bus.process_mailboxes()
    missing = drives[0].mailbox.read_sdo(0x5FFF, 0, False)
    while missing.status() == MessageStatus.RUNNING:
        bus.process_mailboxes()
    return {
        "slaves": len(drives),
        "sizes": [[drive.output_size, drive.input_size] for drive in drives],
        "states": [int(bus.get_state(drive).value) for drive in drives],
        "name": bytes(name.data[: name.size]).decode(),
        "missing": str(missing.status()),
        "inputs": drives[0].input_data.hex(),
    }
