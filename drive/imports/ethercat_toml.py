"""The file ethercat.toml of an imported drive: everything but objects and PDOs."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..ethercat import sii
from ..ethercat.controller.record import SII_BYTES
from ..ethercat.description import INPUTS, OUTPUTS, Description, Mailboxes, SyncManager
from ..model.ethercat import MEMORY, PROTOCOLS, EtherCat
from ..model.made import Repair, line
from ..model.model import load
from .ethercat_pdos import EthercatPdos

ENOUGH = 4096  # bytes of an EEPROM for the names that a model writes into it
_NAMED = 16  # bytes that an entry and its name take in it, about
_COE_DETAILS = 0x0D  # SDO, assignment and mapping of PDOs
_MAILBOX_OUT, _MAILBOX_IN, _OUTPUTS, _INPUTS = 1, 2, 3, 4  # uses of a sync manager
_CONTROL = {_MAILBOX_OUT: 0x26, _MAILBOX_IN: 0x22, _OUTPUTS: 0x24, _INPUTS: 0x20}
_SHORTEST_MAILBOX = 34
_LONGEST_BUFFER = 1024


class EthercatToml:
    """The file of one device.

    Args:
        device: the device.
        pdos: its PDOs, as they were made.
        repairs: receives what could not be used as it stands.
    """

    def __init__(self, device: Description, pdos: EthercatPdos, repairs: list[Repair]):
        self.device = device
        self.pdos = pdos
        self.repairs = repairs
        usual = load("generic", "ethercat").ethercat
        assert usual is not None
        self._usual: EtherCat = usual

    def text(
        self, source: str, vendor: str, registers: Mapping[int, bytes], image: bytes = b"",
        least: int = 0,
    ) -> str:
        """Make the text of the file.

        Args:
            source: name of the manufacturer's file or of the slave.
            vendor: name of the manufacturer.
            registers: of the slave controller, by address.
            image: the manufacturer's EEPROM, empty if it was not read.
            least: size of the EEPROM at least (bytes).
        """
        device = self.device
        mailbox = self._mailboxes(device.mailbox, self._usual.mailbox, "mailbox")
        has_boot = device.bootstrap != Mailboxes(0, 0, 0, 0)
        boot = self._mailboxes(device.bootstrap, mailbox, "bootstrap") if has_boot else (0, 0, 0, 0)
        managers = {manager.kind: manager for manager in device.sync_managers}
        start, length = self._buffers(managers, mailbox)
        protocols = [p for n, p in enumerate(PROTOCOLS) if device.protocols >> n & 1]
        if "CoE" not in protocols:
            self._repair("Mailbox", "no CoE", "CoE", "a model has no other access to its objects")
            protocols.append("CoE")
        size = self._eeprom(least)
        control = {kind: managers[kind].control if kind in managers else usual
                   for kind, usual in _CONTROL.items()}
        modes = ", ".join(
            f"{{ name = {self._carried('a mode of SYNC', mode.name, f'mode {n}')}, "
            f"assign_activate = 0x{mode.assign_activate & 0x7FFF:04X}, "
            f"cycle_factor0 = {max(mode.cycle_factor0, 0)} }}"
            for n, mode in enumerate(device.dc_modes, 1)
        )
        # the controller loads its PDI control from the EEPROM (ETG.1000.4)
        loaded = {0x0140: device.pdi_control.to_bytes(2, "little")} if device.pdi_control else {}
        excludes = ", ".join(f"0x{pdo.index:04X} = {[*pdo.excludes]}"
                             for pdo in (*device.rpdos, *device.tpdos) if pdo.excludes)
        lines = [
            f"# From {line(source)}; see README.md for what is inferred.",
            f"name = {self._carried('Name', device.name, 'drive')}",
            f"order = {self._carried('Type', device.order, 'drive')}",
            f"group = {self._carried('GroupType', device.group, 'Drive')}",
            f"vendor = {json.dumps(line(vendor) or 'unknown')}",
            "", "[mailbox]",
            f"standard = {[*mailbox]}", f"bootstrap = {[*boot]}",
            f"shortest = {min(_SHORTEST_MAILBOX, mailbox[1], mailbox[3])}",
            f"protocols = {json.dumps(protocols)}",
            f"coe_details = 0x{device.coe_details or _COE_DETAILS:02X}",
            "", "[process_data]",
            f"start = {[*start]}", f"length = {length}",
            f"control = {[control[_OUTPUTS], control[_INPUTS]]}",
            f"mailbox_control = {[control[_MAILBOX_OUT], control[_MAILBOX_IN]]}",
            f"fmmu = {[*(device.fmmus or self._usual.fmmu)]}",
            "", "[sii]",
            f"size = {size}", f"version = {device.version}",
            f"pdi_control = 0x{device.pdi_control:04X}",
            f"pdi_configuration = 0x{device.pdi_configuration:04X}",
            f"eoe_details = {device.eoe_details}", f"flags = 0x{device.flags:02X}",
            f"ds402_channels = {device.ds402_channels}",
            *self._image(image, size), "", "[registers]",
            *(f'0x{address:04X} = "{value.hex().upper()}"'
              for address, value in (loaded | dict(registers)).items()),
            "", "[pdo]",
            f"mappable = {self.pdos.mappable}", "fixed_alone = false",
            f"excludes = {{ {excludes} }}",
            "", "[dc]",
            "cycle_ns = 500_000 # inferred, that of generic",
            "late_limit = 7 # inferred, that of generic",
            "hop_delay_ns = 500 # inferred", "error_settings = true # inferred",
            f"modes = [{modes}]",
            "", "[al]", f"bootstrap = {json.dumps(has_boot)}",
        ]
        return "\n".join(lines) + "\n"

    def _repair(self, where: str, says: str, taken: str, why: str) -> None:
        self.repairs.append(Repair(0, where, says, taken, why))

    def _carried(self, where: str, text: str, otherwise: str) -> str:
        """A text for the EEPROM, which can hold Latin-1 only (`sii`), as TOML."""
        whole = line(text)
        kept = whole.encode("latin-1", "ignore").decode("latin-1").strip() or otherwise
        if whole and kept != whole:
            self._repair(where, whole, kept, "an EEPROM holds no other characters")
        return json.dumps(kept)

    def _image(self, image: bytes, size: int) -> list[str]:
        """The manufacturer's EEPROM image, unless something in it had to be repaired."""
        if not image or len(image) > size or self.repairs:
            return []
        return ["# the manufacturer's; without the next line, the image is made from this folder",
                f'image = "{base64.b64encode(image).decode()}"']

    def _mailboxes(
        self, boxes: Mailboxes, usual: Sequence[int], name: str
    ) -> tuple[int, int, int, int]:
        """Start and length of both mailboxes; the usual ones if those described do not fit."""
        out, out_length, into, in_length = found = (
            boxes.out_start, boxes.out_length, boxes.in_start, boxes.in_length
        )
        inside = all(MEMORY[0] <= start < start + length <= MEMORY[1]
                     for start, length in ((out, out_length), (into, in_length)))
        apart = out + out_length <= into or into + in_length <= out
        if inside and apart and min(out_length, in_length) > 16:
            return found
        self._repair(name, f"{out:04X}h {out_length}, {into:04X}h {in_length}",
                     f"{usual[0]:04X}h {usual[1]}, {usual[2]:04X}h {usual[3]}",
                     "it lies outside the memory, or is too short for SDO")
        return usual[0], usual[1], usual[2], usual[3]

    def _buffers(
        self, managers: Mapping[int, SyncManager], mailbox: Sequence[int]
    ) -> tuple[tuple[int, int], int]:
        """Start of outputs and inputs, and the number of bytes available for each."""
        starts = [managers[kind].start if kind in managers else 0 for kind in (_OUTPUTS, _INPUTS)]
        boxes = [(mailbox[0], mailbox[1]), (mailbox[2], mailbox[3])]
        need = max(8, *(self.pdos.bytes_of(manager) for manager in (OUTPUTS, INPUTS)))

        def room(pair: Sequence[int]) -> int:
            if not all(MEMORY[0] <= start < MEMORY[1] for start in pair) or pair[0] == pair[1]:
                return 0
            ends = [start for start, _ in boxes] + [*pair, MEMORY[1]]
            inside = any(b <= s < b + n for s in pair for b, n in boxes)
            return 0 if inside else min(min(e for e in ends if e > s) - s for s in pair)

        if (length := room(starts)) < need:
            free = max(b + n for b, n in boxes)
            usual = self._usual.start
            pair = next((p for p in (usual, (free, free + 1024)) if room(p) >= need), None)
            if pair is None:
                raise ValueError(f"no place for {need} bytes of process data beside the mailboxes")
            self._repair("Sm 2, Sm 3", ", ".join(f"{s:04X}h" for s in starts),
                         ", ".join(f"{s:04X}h" for s in pair),
                         f"{need} bytes do not fit there")
            starts, length = [*pair], room(pair)
        return (starts[0], starts[1]), min(length, _LONGEST_BUFFER)

    def _eeprom(self, least: int) -> int:
        """A size sufficient for the generated content, at least that of the description."""
        device = self.device
        size = device.size if 256 <= device.size <= SII_BYTES and device.size % 128 == 0 else 0
        try:
            image = sii.pack(replace(device, size=1 << 16)).rstrip(b"\xff")
            used = len(image) + _NAMED * self.pdos.padding
        except ValueError:
            used = ENOUGH
        taken = size
        if used > size or least:
            taken = max(size, least, min(-(-used // 1024) * 1024, ENOUGH))
        if taken != device.size:
            self._repair("Eeprom", f"{device.size} bytes", f"{taken}", "the image needs them, or "
                         "an EEPROM cannot have this size here")
        return taken
