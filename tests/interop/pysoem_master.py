"""What an unmodified pysoem does on the wire; each function runs beside `servogym ethercat`."""

import contextlib
import hashlib
import itertools
import struct
import time

import pysoem

PORT, SECOND = "vb", "vb2"
WAIT = 1_000_000  # µs; SOEM's own 2 ms are short for a machine that does other things as well
SCANS = 20
NO_OBJECT = 0x0602_0000  # abort code
COMMANDS = {0x40: 0x06, 0x21: 0x07, 0x23: 0x0F}  # status & 6Fh -> controlword


def opened(second=False):
    master = pysoem.Master()
    master.open(PORT, SECOND) if second else master.open(PORT)
    return master


def scan_of(master):
    """Find the slaves; SOEM finds none where an answer takes longer than its 2 ms."""
    for _ in range(SCANS):
        if master.config_init() > 0:
            return
        time.sleep(0.02)
    raise RuntimeError("the scan did not go on in time")


def cycle(master, times=1):
    """Process data; -> working counters that were wrong."""
    wrong = 0
    for _ in range(times):
        master.send_processdata()
        wrong += master.receive_processdata(WAIT) != master.expected_wkc
    return wrong


def to_op(master):
    """INIT to OP as the examples of pysoem have it; -> the state."""
    scan_of(master)
    master.config_map()
    if master.expected_wkc != 3 * len(master.slaves):  # SOEM maps nothing where an SDO is late
        raise RuntimeError("the mapping did not go on in time")
    if master.state_check(pysoem.SAFEOP_STATE, 5_000_000) != pysoem.SAFEOP_STATE:
        master.read_state()  # refused where SOEM mapped something else, as an SDO was late
        why = [pysoem.al_status_code_to_string(s.al_status) for s in master.slaves]
        raise RuntimeError(f"the way to SAFE_OP did not go on in time: {why}")
    cycle(master)
    master.state = pysoem.OP_STATE
    master.write_state()
    for _ in range(200):
        cycle(master)
        if master.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE:
            break
    else:
        raise RuntimeError("the way to OP did not go on in time")
    return master.state_check(pysoem.OP_STATE, 50_000)


def scan():
    master = opened()
    scan_of(master)
    master.config_map()
    result = [
        {"name": s.name, "vendor": s.man, "product": s.id, "revision": s.rev,
         "outputs": len(s.output), "inputs": len(s.input)}
        for s in master.slaves
    ]
    master.close()
    return result


def ten_thousand_cycles(cycles=10_000):
    master = opened()
    state = to_op(master)
    begin = time.perf_counter()
    wrong = cycle(master, cycles)
    seconds = time.perf_counter() - begin
    master.close()
    return {"state": state, "wrong": wrong, "rate": cycles / seconds}


# ------------------------------------------------------------------- faults

SMALL = 150_000  # µs, for frames that do not come


def one_cycle(master):
    master.send_processdata()
    return master.receive_processdata(SMALL)


def recover(master, tries=40):
    """What the example of pysoem does: acknowledge, reconfigure or recover, request OP again."""
    steps = set()
    for _ in range(tries):
        one_cycle(master)
        master.read_state()
        for slave in master.slaves:
            if slave.state == pysoem.SAFEOP_STATE + pysoem.STATE_ERROR:
                steps.add("acknowledged")
                slave.state = pysoem.SAFEOP_STATE + pysoem.STATE_ACK
                slave.write_state()
            elif slave.state & pysoem.STATE_ERROR:
                steps.add("acknowledged")
                slave.state = (slave.state & 15) + pysoem.STATE_ACK
                slave.write_state()
            elif slave.state == pysoem.SAFEOP_STATE:
                steps.add("requested OP")
                slave.state = pysoem.OP_STATE
                slave.write_state()
            elif pysoem.NONE_STATE < slave.state < pysoem.SAFEOP_STATE:
                steps.add("reconfigured")
                if slave.reconfig(50):
                    slave.is_lost = False
            elif slave.state == pysoem.NONE_STATE:
                steps.add("recovered")
                slave.is_lost = not slave.recover(50)
        if one_cycle(master) == master.expected_wkc and all(
            s.state == pysoem.OP_STATE for s in master.slaves
        ):
            break
    return sorted(steps)


def read_again(slave, index):
    """An SDO; where its answer comes later than SOEM waits, the next one."""
    for _ in range(SCANS):
        with contextlib.suppress(pysoem.WkcError):
            return slave.sdo_read(index, 0)
        time.sleep(0.02)
    return slave.sdo_read(index, 0)


def suffer(line, models=("kollmorgen_akd", "kollmorgen_akd")):
    """One fault, what the master saw of it, and its way back."""
    import wire

    with wire.forked(models, line.split("; ")):
        master = opened()
        state = to_op(master)
        seen, refused = [], ""
        if line.startswith("mailbox"):
            try:
                seen = [master.slaves[0].sdo_read(0x1008, 0).decode() for _ in range(3)]
            except pysoem.SdoError as error:
                refused = f"SdoError {error.abort_code:08X}"
            except (pysoem.MailboxError, pysoem.PacketError, pysoem.WkcError) as error:
                refused = type(error).__name__
            seen.append(read_again(master.slaves[0], 0x1008).decode())
        else:
            seen = [one_cycle(master) for _ in range(150)]
        master.read_state()
        states = [(s.state, s.al_status) for s in master.slaves]
        steps = recover(master)
        master.read_state()
        result = {
            "state": state, "seen": seen, "refused": refused, "states": states, "steps": steps,
            "back": [s.state for s in master.slaves], "expected": master.expected_wkc,
            "last": one_cycle(master),
        }
        master.close()
    return result


class Axis:
    """Outputs and inputs of fixed PDOs by name: (format, names)."""

    def __init__(self, master, slave, outputs, inputs):
        self.master, self.slave = master, slave
        self._out, self._names = outputs
        self._in, self._shown = inputs
        self.commands = dict.fromkeys(self._names, 0)

    def cycle(self, times=1, **commands):
        self.commands |= commands
        values = [self.commands[name] for name in self._names]
        self.slave.output = struct.pack(self._out, *values)
        wrong = cycle(self.master, times)
        assert not wrong
        return dict(zip(self._shown, struct.unpack(self._in, self.slave.input), strict=True))

    def enable(self, **commands):
        seen = self.cycle(**commands)
        for _ in range(2000):
            state = seen["statusword"] & 0x6F
            if state == 0x27:
                return seen
            seen = self.cycle(
                controlword=COMMANDS.get(state | (0x20 if state & 1 else 0), 0x06)
                if state != 0x60
                else 0x06
            )
        raise AssertionError(f"statusword {seen['statusword']:04X}h")


def home_and_move(distance=100_000, method=1, cycles=1000):
    """Enable, home by method 1, move 0.1 m in csp; -> the places of the axis and their digest."""
    master = opened()
    slave = None

    def assign(_):
        for manager, pdo in ((0x1C12, 0x1724), (0x1C13, 0x1B24)):
            slave.sdo_write(manager, 0, b"\0")
            slave.sdo_write(manager, 1, struct.pack("<H", pdo))
            slave.sdo_write(manager, 0, b"\1")

    scan_of(master)
    slave = master.slaves[0]
    slave.config_func = assign
    master.config_map()
    assert master.state_check(pysoem.SAFEOP_STATE, 5_000_000) == pysoem.SAFEOP_STATE
    axis = Axis(master, slave, ("<iHh", ("target_position", "controlword", "torque_offset")),
                ("<iH", ("position", "statusword")))
    master.state = pysoem.OP_STATE
    axis.cycle()
    master.write_state()
    while master.state_check(pysoem.OP_STATE, 1000) != pysoem.OP_STATE:
        axis.cycle()
    slave.sdo_write(0x6098, 0, struct.pack("<b", method))
    slave.sdo_write(0x607C, 0, bytes(4))  # zero at the switch: inside the software limits
    slave.sdo_write(0x6060, 0, b"\6")
    axis.enable()
    seen = axis.cycle(controlword=0x1F)
    trace = []
    for _ in range(100_000):
        seen = axis.cycle()
        trace.append(seen["position"])
        if seen["statusword"] & 0x1400 == 0x1400:
            break
        assert not seen["statusword"] & 0x2000, "homing error"
    homed = seen["position"]
    seen = axis.cycle(controlword=0x0F, target_position=homed)
    slave.sdo_write(0x6060, 0, b"\x08")
    axis.cycle(20)
    for n in range(cycles):
        share = (n + 1) / cycles
        place = homed + round(distance * (3 * share**2 - 2 * share**3))
        seen = axis.cycle(target_position=place)
        trace.append(seen["position"])
    for _ in range(500):
        seen = axis.cycle()
        trace.append(seen["position"])
    axis.cycle(controlword=0)
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()
    return {
        "homed": homed, "end": seen["position"], "statusword": seen["statusword"],
        "trace": hashlib.sha256(struct.pack(f"<{len(trace)}i", *trace)).hexdigest(),
    }


# ------------------------------------------------- process images, clocks, redundancy


def fixed_pdos(pairs):
    """Every PDO of a list assigned and exchanged: sizes, state, how far the drive moves.

    A pair is the PDOs of both directions, and the mapping of those that are flexible.
    """
    found = []
    for output, given, *mapped in pairs:
        master = opened()
        scan_of(master)
        slave = master.slaves[0]

        def assign(_, slave=slave, pair=(output, given), mapped=mapped):
            for manager, pdos in zip((0x1C12, 0x1C13), pair, strict=True):
                slave.sdo_write(manager, 0, b"\0")
                for pdo, entry in mapped:
                    if pdo in pdos:
                        slave.sdo_write(pdo, 0, b"\0")
                        slave.sdo_write(pdo, 1, struct.pack("<I", entry))
                        slave.sdo_write(pdo, 0, b"\1")
                for n, pdo in enumerate(pdos, 1):
                    slave.sdo_write(manager, n, struct.pack("<H", pdo))
                slave.sdo_write(manager, 0, bytes([len(pdos)]))

        slave.config_func = assign
        master.config_map()
        safe = master.state_check(pysoem.SAFEOP_STATE, 5_000_000)
        mapping = []
        for pdos in (output, given):
            rows = []
            for pdo in pdos:
                for n in range(slave.sdo_read(pdo, 0)[0]):
                    rows.append(struct.unpack("<I", slave.sdo_read(pdo, n + 1))[0])
            mapping.append(rows)
        master.state = pysoem.OP_STATE
        cycle(master)
        master.write_state()
        while master.state_check(pysoem.OP_STATE, 1000) != pysoem.OP_STATE:
            cycle(master)
        before, after, moved = moved_by_image(master, slave, mapping[0])
        found.append({
            "pdos": [output, given], "safe": safe, "sizes": [len(slave.output), len(slave.input)],
            "managers": [register(slave, 0x0812, 2), register(slave, 0x081A, 2)],
            "mapping": mapping, "status": [before, after], "moved": moved,
        })
        master.state = pysoem.INIT_STATE
        master.write_state()
        master.close()
    return found


def as_found(distance, cycles=4000):
    """A drive as its own description has it: its PDOs, enabled, moved in csp where it can be.

    Returns identity, bytes of both directions, state, statusword, way of 6064h (drive units).
    """
    master = opened()
    state = to_op(master)
    slave = master.slaves[0]
    image = []
    for manager in (0x1C12, 0x1C13):
        at, places = 0, {}
        for n in range(read_again(slave, manager)[0]):
            (pdo,) = struct.unpack("<H", slave.sdo_read(manager, n + 1))
            for k in range(slave.sdo_read(pdo, 0)[0]):
                (entry,) = struct.unpack("<I", slave.sdo_read(pdo, k + 1))
                places[entry >> 16] = at
                at += (entry & 0xFF) // 8
        image.append(places)
    outputs, given = image
    out = bytearray(slave.output)

    def put(index, data):
        if index in outputs:
            out[outputs[index] : outputs[index] + len(data)] = data
        else:
            slave.sdo_write(index, 0, data)

    def get(index, form):
        if index in given:
            return struct.unpack_from(form, slave.input, given[index])[0]
        return struct.unpack(form, slave.sdo_read(index, 0))[0]

    found = {"identity": [slave.man, slave.id, slave.rev], "sizes": [len(out), len(slave.input)],
             "state": state, "moved": None}
    try:
        put(0x6060, b"\x08")
    except pysoem.SdoError as error:
        # some have one mode alone, or do not say it
        if error.abort_code != NO_OBJECT and read_again(slave, 0x6060) != b"\x08":
            found["why"] = f"6060h: {error}"
    if 0x607A in outputs:
        put(0x607A, struct.pack("<i", get(0x6064, "<i")))
    word = 0
    for _ in range(1000):
        status = get(0x6041, "<H")
        word = COMMANDS.get(status & 0x6F, word)
        if status & 0x6F == 0x27:
            break
        put(0x6040, struct.pack("<H", word))
        slave.output = bytes(out)
        cycle(master)
    if status & 0x6F == 0x27 and 0x607A in outputs and "why" not in found:
        begin = get(0x6064, "<i")
        for n in range(cycles + 500):
            part = min(n / cycles, 1)
            way = round(distance * part * part * (3 - 2 * part))
            put(0x607A, struct.pack("<i", begin + way))
            slave.output = bytes(out)
            cycle(master)
        found["moved"] = get(0x6064, "<i") - begin
    found["status"] = get(0x6041, "<H")
    master.close()
    return found


# entry with a set-point -> mode of operation, controlword that starts the motion
MOTIONS = {0x60C10120: (7, 0x1F), 0x607A0020: (8, 0x0F), 0x60FF0020: (9, 0x0F)}
CONTROLWORD, MAX_TORQUE = 0x60400010, 0x60720010
STEP, SPEED = 50, 20_000  # µm a cycle, µm/s


def moved_by_image(master, slave, entries, cycles=200):
    """Enable through the image and move; -> statusword before and after, and the way (µm).

    Without a set-point in the image there is no way.
    """
    image = dict.fromkeys(entries, 0)
    if MAX_TORQUE in image:
        image[MAX_TORQUE] = 1000
    point = next((entry for entry in entries if entry in MOTIONS), None)
    mode, start = MOTIONS.get(point, (1, 0x0F))
    slave.sdo_write(0x6060, 0, bytes([mode]))

    def send(times=1):
        slave.output = b"".join(
            value.to_bytes((entry & 0xFF) // 8, "little", signed=True)
            for entry, value in image.items()
        )
        assert not cycle(master, times)

    def value(index, size):
        return int.from_bytes(slave.sdo_read(index, 0)[:size], "little", signed=size == 4)

    begin = value(0x6064, 4)
    if point is not None and mode != 9:
        image[point] = begin
    shown = []
    for command in (0, 6, 7, 15):
        image[CONTROLWORD] = command
        send(20)
        shown.append(value(0x6041, 2) & 0x6F)
    image[CONTROLWORD] = start
    moved = None
    if point is not None:
        begin = value(0x6064, 4)
        for _ in range(cycles):
            image[point] = SPEED if mode == 9 else image[point] + STEP
            send()
        send(50)
        moved = value(0x6064, 4) - begin
    image[CONTROLWORD] = 0
    send(5)
    return shown[0], shown[-1], moved


def register(slave, address, size):
    return int.from_bytes(slave._fprd(address, size), "little")


def delays():
    """0928h of all slaves after SOEM's own configuration of the clocks."""
    master = opened()
    scan_of(master)
    master.config_map()
    master.config_dc()
    found = [register(slave, 0x0928, 4) for slave in master.slaves]
    master.close()
    return found


def line_of(n):
    import wire

    with wire.forked(["kollmorgen_akd"] * n):
        return delays()


def redundancy(cycles=150):
    """A ring of four slaves; the cable between the second and the third breaks and heals."""
    master = opened(second=True)
    state = to_op(master)
    seen, links = [], []
    for n in range(cycles):
        master.send_processdata()
        seen.append(master.receive_processdata(WAIT))
        if n in (cycles // 3, cycles - 1):
            links.append([register(slave, 0x0110, 2) for slave in master.slaves])
    master.read_state()
    result = {"state": state, "seen": seen, "expected": master.expected_wkc, "links": links,
              "states": [s.state for s in master.slaves]}
    master.close()
    return result


def kilohertz(server, seconds=5.0):
    """A kilohertz of cycles with SYNC0 on the clock dc; -> errors, and the server's memory."""
    master = opened()
    scan_of(master)
    master.config_map()
    master.config_dc()
    for slave in master.slaves:
        slave.dc_sync(True, 1_000_000, 250_000)
    state = master.state_check(pysoem.SAFEOP_STATE, 5_000_000)
    cycle(master)
    master.state = pysoem.OP_STATE
    master.write_state()
    for _ in range(500):
        cycle(master)
        time.sleep(0.001)
        if master.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE:
            break
    late, wrong = 0, []  # number of the cycle and working counter
    sizes = []
    begin = due = time.perf_counter()
    while due < begin + seconds:
        master.send_processdata()
        counter = master.receive_processdata(WAIT)
        if counter != master.expected_wkc:
            wrong.append((round((due - begin) * 1000), counter))
        if not sizes and due > begin + min(seconds / 2, 30):
            sizes.append(memory_of(server))
        due += 0.001
        rest = due - time.perf_counter()
        late += rest < 0
        time.sleep(max(rest, 0))
    sizes.append(memory_of(server))
    result = {
        "safe": state, "state": master.state_check(pysoem.OP_STATE, 50_000), "wrong": wrong,
        "late": late, "memory_kib": sizes, "clock": [register(s, 0x092C, 4) for s in master.slaves],
    }
    master.close()
    return result


def memory_of(process):
    with open(f"/proc/{process.pid}/status") as status:
        return int(next(line for line in status if line.startswith("VmRSS")).split()[1])


# ------------------------------------------------------------------- three clocks, SYNC0


def with_sync0(clock, when, period=10, cycles=100):
    """OP with SYNC0 off, set in PRE_OP or behind SAFE_OP; -> states, DC time of each cycle (ms)."""
    paced = clock != "frame"
    master = opened()
    scan_of(master)
    (slave,) = master.slaves

    def hook(_):
        slave.sdo_write(0x60C2, 1, bytes([period]))
        if when == "before":
            slave.dc_sync(True, period * 1_000_000)

    def step():
        begin = time.perf_counter()
        wrong = cycle(master)
        if paced:
            time.sleep(max(period / 1000 - (time.perf_counter() - begin), 0))
        return wrong

    if when == "before":
        master.config_dc()
    slave.config_func = hook
    master.config_map()
    safe = master.state_check(pysoem.SAFEOP_STATE, 5_000_000)
    if when == "behind":
        master.config_dc()
        slave.dc_sync(True, period * 1_000_000)
    for _ in range(30):  # SOEM lets SYNC0 begin 100 ms later
        step()
    master.state = pysoem.OP_STATE
    master.write_state()
    for _ in range(100):
        step()
        if master.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE:
            break
    wrong, times, status = 0, [], []
    words = {0x40: 6, 0x21: 7, 0x23: 15, 0x27: 15}
    for _ in range(cycles):
        (shown,) = struct.unpack_from("<H", slave.input)
        status.append(shown & 0x6F)
        slave.output = struct.pack("<H", words.get(shown & 0x6F, 6)) + slave.output[2:]
        wrong += step()
        times.append(register(slave, 0x0910, 8))
    master.read_state()
    result = {
        "safe": safe, "state": slave.state, "code": slave.al_status, "wrong": wrong,
        "status": status[-1],
        "passed": [(b - a) / 1e6 for a, b in itertools.pairwise(times)],
    }
    slave.dc_sync(False, 0)
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()
    return result


# ------------------------------------------------------------- a model of a slave that answers


def imported(folder):
    """A model made from the slave; -> what became of it."""
    from servogym.drive.wire.slave_import import import_slave

    for _ in range(SCANS):
        try:
            made = import_slave(PORT, __import__("pathlib").Path(folder))
            break
        except (TimeoutError, ValueError) as error:
            if "slaves answer" not in str(error) and not isinstance(error, TimeoutError):
                raise
            time.sleep(0.02)
    return {"name": made.name, "objects": made.objects, "pdos": made.pdos,
            "repairs": [str(repair) for repair in made.repairs]}
