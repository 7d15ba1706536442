"""The description of a device, from which SII image and ESI file are made.

Both can be parsed back into it, so EEPROM, file and dictionary agree (ETG.2000, ETG.2010).
"""

from dataclasses import dataclass, field

from ..model.ethercat import PROTOCOLS
from ..model.model import DriveModel
from ..model.pdo import Mapping
from ..model.rows import DATA_TYPES
from ..objects.hooks.ethercat import excluded, mappable

UNASSIGNED = 0xFF  # sync manager of a PDO that is not assigned by default
FIXED = 0x0010  # flag of a PDO: its content cannot be changed
OUTPUTS, INPUTS = 2, 3  # sync managers of the process data
TWO_MII_PORTS = 0x0011


@dataclass(frozen=True)
class Entry:
    """An entry of a PDO; index 0 is a gap."""

    index: int
    subindex: int
    bits: int
    data_type: int  # number of CiA 301
    name: str = ""


@dataclass(frozen=True)
class Pdo:
    """A PDO with its default content."""

    index: int
    name: str
    sync_manager: int  # `UNASSIGNED` where the default assignment leaves it out
    flags: int
    entries: tuple[Entry, ...]
    # PDOs that it cannot be assigned with; only an ESI has them, so an EEPROM does not differ in it
    excludes: tuple[int, ...] = field(default=(), compare=False)

    @property
    def bits(self) -> int:
        """Length of the PDO."""
        return sum(entry.bits for entry in self.entries)


@dataclass(frozen=True)
class SyncManager:
    """A sync manager as the master should set it."""

    start: int
    length: int
    control: int
    enable: int
    kind: int  # 1 mailbox out, 2 mailbox in, 3 outputs, 4 inputs


@dataclass(frozen=True)
class DcMode:
    """A way to synchronise that a master may choose (operation mode of distributed clocks)."""

    name: str
    assign_activate: int  # for register 0980h
    cycle_time0: int = 0  # ns
    shift_time0: int = 0  # ns
    shift_time1: int = 0  # ns
    cycle_factor0: int = 0
    cycle_factor1: int = 0


@dataclass(frozen=True)
class Mailboxes:
    """Start and length of the two mailboxes: out is from the master."""

    out_start: int
    out_length: int
    in_start: int
    in_length: int


@dataclass(frozen=True)
class Description:
    """A device; fields that only SII or only ESI contains are marked."""

    vendor_id: int
    product_code: int
    revision_number: int
    serial_number: int  # SII
    name: str
    order: str
    group: str
    mailbox: Mailboxes
    bootstrap: Mailboxes
    protocols: int  # bits of word 1Ch of the SII: 2 EoE, 4 CoE, 8 FoE
    coe_details: int  # bits of the category general: 1 SDO, 2 information, 4 assign, 8 mapping ...
    foe_details: int
    eoe_details: int
    flags: int  # of the category general
    physical_ports: int
    fmmus: tuple[int, ...]  # 1 outputs, 2 inputs, 3 mailbox state, 0 unused
    sync_managers: tuple[SyncManager, ...]
    tpdos: tuple[Pdo, ...]
    rpdos: tuple[Pdo, ...]
    dc_modes: tuple[DcMode, ...]
    pdi_control: int = 0
    pdi_configuration: int = 0
    alias: int = 0  # SII
    version: int = 1  # SII
    size: int = 2048  # bytes of the EEPROM
    vendor_strings: tuple[tuple[int, str], ...] = ()  # SII: categories of the vendor
    ds402_channels: int = 0  # SII: axes, where it says so

    def assigned(self, sync_manager: int) -> tuple[Pdo, ...]:
        """The PDOs that a sync manager has by default."""
        return tuple(pdo for pdo in self.rpdos + self.tpdos if pdo.sync_manager == sync_manager)


def default_assignment(model: DriveModel, index: int) -> list[int]:
    """The PDOs that 1C12h or 1C13h has at power-on."""
    count = int(model.objects[index, 0].default)
    return [int(model.objects[index, n + 1].default) for n in range(count)]


def describe(model: DriveModel, alias: int = 0) -> Description:
    """Describe a model with EtherCAT; `alias` is its station alias.

    Raises ValueError for a model without EtherCAT.
    """
    ethercat = model.ethercat
    if ethercat is None:
        raise ValueError(f'drive {model.name!r} is on {model.bus}: load it with bus="ethercat"')
    rpdos = _pdos(model, model.rpdos, OUTPUTS, 0x1C12)
    tpdos = _pdos(model, model.tpdos, INPUTS, 0x1C13)
    out, out_length, in_, in_length = ethercat.mailbox
    sizes = [sum(pdo.bits for pdo in pdos if pdo.sync_manager != UNASSIGNED) // 8
             for pdos in (rpdos, tpdos)]
    starts = ((out, out_length), (in_, in_length), *zip(ethercat.start, sizes, strict=True))
    controls = (*ethercat.mailbox_control, *ethercat.control)
    managers = [
        SyncManager(start, length, control, 1, kind)
        for kind, ((start, length), control) in enumerate(zip(starts, controls, strict=True), 1)
    ]
    vendor, product, revision, serial = (
        int(model.objects[0x1018, n].default) for n in (1, 2, 3, 4)
    )
    return Description(
        vendor_id=vendor,
        product_code=product,
        revision_number=revision,
        serial_number=serial,
        name=ethercat.name,
        order=ethercat.order,
        group=ethercat.group,
        mailbox=Mailboxes(*ethercat.mailbox),
        bootstrap=Mailboxes(*ethercat.bootstrap),
        protocols=sum(1 << PROTOCOLS.index(protocol) for protocol in ethercat.protocols),
        coe_details=ethercat.coe_details,
        foe_details=int("FoE" in ethercat.protocols),
        eoe_details=ethercat.eoe_details,
        flags=ethercat.flags,
        ds402_channels=ethercat.ds402_channels,
        physical_ports=TWO_MII_PORTS,
        fmmus=ethercat.fmmu,
        sync_managers=tuple(managers),
        tpdos=tpdos,
        rpdos=rpdos,
        dc_modes=tuple(
            DcMode(mode.name, mode.assign_activate, cycle_factor0=mode.cycle_factor0)
            for mode in ethercat.modes
        ),
        pdi_control=ethercat.pdi_control,
        pdi_configuration=ethercat.pdi_configuration,
        alias=alias,
        version=ethercat.sii_version,
        size=ethercat.sii_size,
        vendor_strings=ethercat.strings,
    )


def _pdos(
    model: DriveModel, mappings: tuple[Mapping, ...], manager: int, assignment: int
) -> tuple[Pdo, ...]:
    """PDOs by index; the names of their entries are those of the objects."""
    assigned, apart = default_assignment(model, assignment), excluded(model, assignment)
    flexible = mappable(model)[manager - OUTPUTS]
    letter = "R" if manager == OUTPUTS else "T"
    pdos = []
    for place, mapping in enumerate(mappings):
        index = int(mapping.cob_id, 0)
        entries = []
        for target, subindex, bits in mapping.entries:
            row = model.objects.get((target, subindex))
            data_type = DATA_TYPES[row.data_type] if row and row.size * 8 == bits else 0
            entries.append(Entry(target, subindex, bits, data_type, row.name if row else ""))
        pdos.append(
            Pdo(
                index, f"{letter}xPDO {index:04X}h", manager if index in assigned else UNASSIGNED,
                0 if place < flexible else FIXED, tuple(entries), tuple(sorted(apart[index])),
            )
        )
    return tuple(sorted(pdos, key=lambda pdo: pdo.index))
