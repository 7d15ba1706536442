"""An EEPROM as a real AKD has it, as far as that is known.

No EEPROM of a real drive is at hand as a file. This image is ours with what is known of a real one:
its serial number, and its names as a public test of an EEPROM reader lists them (ethercrab,
`src/subdevice/eeprom.rs`). Which PDO comes first and the PDOs' own names are `inferred`.
"""

import dataclasses

from servogym.drive.ethercat import sii
from servogym.drive.ethercat.description import describe
from servogym.drive.model.model import load

NAMES = {
    0x6041: "Statusword", 0x6063: "Position actual internal value",
    0x2050: "Second position feedback", 0x606C: "Velocity actual value", 0x60FD: "Digital inputs",
    0x60F4: "Following error actual value", 0x20A0: "Latch 1p", 0x6077: "Torque actual value",
    0x20A5: "Latch statusword", 0x3470: "AIN.VALUE", 0x20A1: "Latch 1n", 0x20A6: "Latch 1 pn",
    0x6064: "Position actual value", 0x20A7: "Latch 2 pn", 0x6040: "Controlword",
    0x60C1: "1st set-point", 0x60FF: "Target velocity", 0x20A4: "Latch controlword",
    0x60B2: "Torque offset", 0x60FE: "Physical outputs", 0x6072: "Max torque",
    0x20B8: "ClearDigInputChangedBit", 0x607A: "Target position", 0x3470_03: "AOUT.VALUE write",
}
SERIAL = 2575499411


def real_eeprom():
    """The image."""
    ours, change = describe(load("kollmorgen_akd", "ethercat")), dataclasses.replace

    def named(pdos, name):
        return tuple(change(pdo, name=name, entries=tuple(
            change(e, name=NAMES.get(e.index << 8 | e.subindex, NAMES[e.index]))
            for e in pdo.entries
        )) for pdo in pdos)

    return sii.pack(change(ours, serial_number=SERIAL, rpdos=named(ours.rpdos, "Outputs"),
                           tpdos=named(ours.tpdos, "Inputs")))
