"""Logs of axes as others make them: an axis in thirty lines, a scope's table, a candump by hand.

Nothing of this project is used: neither its machine nor its writers.
"""

import math
import random

FEED, ROTOR, MASS = 0.06, 6e-5, 7.0  # m a turn, kg·m², kg
COULOMB, VISCOUS, RATED = 14.0, 25.0, 1.27  # N, N·s/m, Nm
STEP, SAMPLE = 1e-4, 2e-3  # s, of the controller and of the log
HEADINGS = "Zeit (ms);Sollwert (mm);Istwert (mm);Drehmoment (Nm);Status"
COLUMNS = ("time=Zeit (ms):ms,target_position=Sollwert (mm):mm,position_actual_value=Istwert (mm)"
           ":mm,torque_actual_value=Drehmoment (Nm):Nm,statusword=Status")


def cosine(begin, way, seconds, time):
    """Place (m) of a move without a kink, at a time (s) from its beginning."""
    share = min(max(time / seconds, 0.0), 1.0)
    return begin + 0.5 * way * (1 - math.cos(math.pi * share))


def there_and_back(time, period=0.9, near=0.12, ways=(0.2, 0.12, 0.22)):
    """Moves to both sides, of different speeds."""
    number, within = divmod(time, period)
    way, back = ways[int(number) // 2 % len(ways)], int(number) % 2
    return cosine(near + way * back, -way if back else way, 0.7, within - 0.05)


def axis(seconds=5.4, places=there_and_back, limit=3.5, seed=1):
    """Rows: time (s), set-point (m), position (m), torque (Nm)."""
    noise = random.Random(seed)
    gear = 2 * math.pi / FEED
    inertia = ROTOR * gear**2 + MASS  # kg, at the load
    x = places(0.0)
    v = integral = 0.0
    rows = []
    for n in range(round(seconds / STEP)):
        time = n * STEP
        asked = places(time)
        speed = (places(time + STEP) - places(time - STEP)) / (2 * STEP) + 60.0 * (asked - x)
        error = (speed - v) * gear
        integral += 0.12 / 0.01 * error * STEP
        torque = min(max(0.12 * error + integral, -limit), limit)
        if n % round(SAMPLE / STEP) == 0:
            rows.append((time, asked, x + noise.gauss(0, 5e-7), torque))
        force = torque * gear - VISCOUS * v
        if v == 0.0 and abs(force) <= COULOMB:
            continue
        sign = math.copysign(1.0, v if v else force)
        faster = v + (force - COULOMB * sign) / inertia * STEP
        v = 0.0 if v * faster < 0.0 else faster
        x += v * STEP
    return rows


def table(file, rows, status=0x1237, headings=HEADINGS):
    """A scope's table: semicolons and decimal commas, ms and mm."""
    lines = [headings]
    for time, asked, place, torque in rows:
        cells = (f"{1e3 * time:.3f}", f"{1e3 * asked:.5f}", f"{1e3 * place:.5f}", f"{torque:.5f}")
        lines.append(";".join([*(cell.replace(".", ",") for cell in cells), f"{status}"]))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def candump(file, rows, nodes=(1,), unit=1e-6, mapped=True, status=0x1237):
    """Frames of nodes that follow one another's set-points, their PDOs mapped by SDO before."""
    lines, at = [], 1700.0

    def frame(identifier, data):
        nonlocal at
        at += 1e-4
        lines.append(f"({at:.6f}) can0 {identifier:03X}#{data.hex().upper()}")

    def write(node, index, subindex, value, size):
        head = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
        put = (value % (1 << 8 * size)).to_bytes(4, "little")
        place = index.to_bytes(2, "little") + bytes([subindex])
        frame(0x600 + node, bytes([head]) + place + put)
        frame(0x580 + node, b"\x60" + place + bytes(4))

    for node in nodes if mapped else ():
        for way, (cob, objects) in enumerate((
            (0x200, (0x60400010, 0x60600008, 0x607A0020)),
            (0x180, (0x60410010, 0x60640020, 0x60770010)),
        )):
            write(node, 0x1400 + 0x400 * way, 1, 0x80000000 + cob + node, 4)
            write(node, 0x1600 + 0x400 * way, 0, 0, 1)
            for n, entry in enumerate(objects, 1):
                write(node, 0x1600 + 0x400 * way, n, entry, 4)
            write(node, 0x1600 + 0x400 * way, 0, 3, 1)
            write(node, 0x1400 + 0x400 * way, 1, cob + node, 4)
    begin = at + 0.01
    for time, asked, place, torque in rows:
        at = begin + time
        for node in nodes:
            here, is_at = round(asked / unit), round(place / unit)
            frame(0x200 + node, b"\x0f\x00\x08" + here.to_bytes(4, "little", signed=True))
            frame(0x180 + node, status.to_bytes(2, "little")
                  + is_at.to_bytes(4, "little", signed=True)
                  + round(1e3 * torque / RATED).to_bytes(2, "little", signed=True))
    file.write_text("\n".join(lines) + "\n", encoding="ascii")
    return file
