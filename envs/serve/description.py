"""The file of `servogym serve`: the machines, and the bus that each of them is on.

A machine file is TOML::

    [bus.can]
    kind = "can"                      # an interface of python-can
    interface = "udp_multicast"
    channel = "239.74.163.2"

    [machine.feeder]
    bus = "can"
    axis = "linear"                   # a kind of `servogym node --axis`
    drive = "festo_cmmp_as"           # a drive model by name or folder
    node_id = 1                       # of its first drive
    positions = { x = 0.12 }          # m or rad at power-on

    [[event]]
    at = 2.0                          # s of the machine's own time
    drive = "feeder.x"
    inject = "overvoltage"
    clear_after = 0.5                 # s
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from ...drive.canopen.faulty import Faults
from ...drive.model.files import content
from ...drive.model.model import load
from ...drive.model.names import hint
from ..engine.checks import in_range, whole
from ..environment.registry import of_a_file
from ..plants.catalogue import AXES, named_for

CAN_CLOCKS = ("real", "sync", "sync_end")
ETHERCAT_CLOCKS = ("frame", "dc", "real")


@dataclass(frozen=True)
class BusRow:
    """One bus.

    Args:
        kind: ``can`` or ``ethercat``.
        clock: what advances the time. On CAN ``real`` (the wall clock), ``sync`` (each SYNC of the
            master, by `period_us`, so runs are repeatable and as fast as the master) or
            ``sync_end`` (the same, but the SYNC ends its period: commands sent before it act for
            all of it, and the answers to it report the result). On EtherCAT ``frame``, ``dc`` or
            ``real``, see `servogym.drive.ethercat.bus`.
        interface: of CAN, the interface of python-can; of EtherCAT, one network interface or two
            for redundancy.
        channel: of CAN.
        udp: of EtherCAT, the address to listen on at UDP port 88A4h instead of an interface.
        period_us: of CAN with the clock ``sync`` or ``sync_end`` (µs); of a task its step, if 0.
        options: of CAN, further keywords of ``can.Bus``.
        faults: of EtherCAT, lines as for ``servogym ethercat --fault``; of CAN, the rate of each
            kind, as ``{ drop = 0.001 }``, see `servogym.drive.canopen.faulty.Faults`.
        log: file for all frames; ``.pcapng`` on EtherCAT, a format of python-can on CAN.

    Raises:
        ValueError: names the field and what it may be.
    """

    name: str
    kind: str
    clock: str = ""
    interface: str | list = ""
    channel: str = ""
    udp: str = ""
    period_us: int = 0
    options: dict = field(default_factory=dict)
    faults: list | dict = field(default_factory=list)
    log: str = ""

    def __post_init__(self) -> None:
        clocks = {"can": CAN_CLOCKS, "ethercat": ETHERCAT_CLOCKS}
        if self.kind not in clocks:
            raise ValueError(f"kind = {self.kind!r}: {hint(self.kind, clocks)}")
        allowed = clocks[self.kind]
        if not self.clock:
            object.__setattr__(self, "clock", allowed[0])
        if self.clock not in allowed:
            raise ValueError(f"clock = {self.clock!r}: use one of {', '.join(allowed)}")
        whole("period_us", self.period_us, 0, 10**9)
        if self.kind == "can":
            given = self.interface or self.options.get("config_context")
            if not (isinstance(self.interface, str) and given):
                raise ValueError("interface: name one of python-can, such as udp_multicast")
            if self.udp:
                raise ValueError("udp is for buses of kind ethercat")
            self.rates()
        else:
            if isinstance(self.faults, dict):
                raise ValueError('faults: give lines, as ["drop at=cycle:100 count=3"]')
            if self.channel or self.options:
                raise ValueError("channel and options are for buses of kind can")
            if bool(self.interfaces) == bool(self.udp):
                raise ValueError("name one interface, two for redundancy, or udp")
            if len(self.interfaces) > 2:
                raise ValueError(f"interface = {self.interface!r}: two at most (redundancy)")
            if self.log and not self.log.endswith(".pcapng"):
                raise ValueError(f"log = {self.log!r}: captures are .pcapng")

    def rates(self) -> Faults:
        """Return the fault rates of a CAN bus. Raises ValueError for an unknown kind."""
        if not isinstance(self.faults, dict):
            if self.faults:
                raise ValueError("faults: give a table, as { drop = 0.001 }")
            return Faults()
        known = [each.name for each in fields(Faults)]
        for name in self.faults:
            if name not in known:
                raise ValueError(f"faults: {name!r} is unknown: {hint(name, known)}")
        return Faults(**self.faults)

    @property
    def keywords(self) -> dict[str, Any]:
        """Keywords of ``can.Bus`` for a CAN bus."""
        return {"interface": self.interface, "channel": self.channel} | self.options

    @property
    def interfaces(self) -> list[str]:
        """Network interfaces of an EtherCAT bus."""
        return [self.interface] if isinstance(self.interface, str) and self.interface else [
            *self.interface
        ]


@dataclass(frozen=True)
class MachineRow:
    """One machine: the mechanics, and the drives that move them.

    Args:
        bus: name of the bus that all its drives are on.
        axis: kind of machine, as ``servogym node --axis`` has it, or ``none``: a drive whose motor
            is held; or
        mjcf: file of a robot of one's own; or
        task: an environment by its id, whose machine it is, as `servogym deploy` commands it.
        drive: drive model by name or folder; of `mjcf` one for each joint, by its name.
        parameters: of the machine, as keywords of its factory (mechanics, payload, …), or of the
            environment.
        positions: of joints at power-on (m or rad), by drive.
        node_id: of its first drive on CAN; the others follow.
        write: objects that are set before the machine is served, by drive and name.
        parameter_file: into which 1010h and LSS store and from which power-on loads; of several
            drives each has its own, with the node-id in its name (on EtherCAT its name).

    Raises:
        ValueError: names the field and what it may be.
    """

    name: str
    bus: str
    axis: str = ""
    mjcf: str = ""
    task: str = ""
    drive: str | dict = "generic"
    parameters: dict = field(default_factory=dict)
    positions: dict = field(default_factory=dict)
    node_id: int = 0
    write: dict = field(default_factory=dict)
    parameter_file: str = ""

    def __post_init__(self) -> None:
        if sum(map(bool, (self.axis, self.mjcf, self.task))) != 1:
            raise ValueError(
                "give axis, a kind of machine, mjcf, a file of your own, or task, an environment"
            )
        if self.mjcf and not isinstance(self.drive, dict):
            raise ValueError('drive: name a model for each joint, as { shoulder = "generic" }')
        if not self.mjcf and not isinstance(self.drive, str):
            raise ValueError("drive: a machine of the family has one model; give its name")
        if self.mjcf and self.parameters:
            raise ValueError("parameters are those of a kind of machine, not of mjcf")


@dataclass(frozen=True)
class EventRow:
    """A fault that is injected into a drive at a given time.

    Args:
        at: time of its machine (s).
        drive: ``MACHINE.DRIVE``, or the machine if it has one drive.
        inject: cause, see `servogym.drive.drive.Drive.injectable`.
        clear_after: how long the cause lasts (s); 0: until it is cleared.

    Raises:
        ValueError: names the field and its range.
    """

    at: float
    drive: str
    inject: str
    clear_after: float = 0.0

    def __post_init__(self) -> None:
        in_range("at", self.at, 0.0, 1e9, "s")
        in_range("clear_after", self.clear_after, 0.0, 1e9, "s")


@dataclass(frozen=True)
class Description:
    """The content of a machine file, or of the options of a command.

    Args:
        folder: the folder from which relative paths start.
        by_options: whether it comes from options, so that errors name these instead of fields.

    Raises:
        ValueError: a machine names a bus that is not there, or two have one node-id.
    """

    buses: tuple[BusRow, ...]
    machines: tuple[MachineRow, ...]
    events: tuple[EventRow, ...] = ()
    folder: Path = Path()
    by_options: bool = False

    def named(self, field: str) -> str:
        """Return the name of a field as the user gave it: in a file, or as an option."""
        return f"--{field.replace('_', '-')}" if self.by_options else field

    def row(self, kind: str, name: str) -> str:
        """Return the beginning of an error message about a row."""
        return "" if self.by_options else f"{kind}.{name}: "

    @property
    def drive_models(self) -> set[str | Path]:
        """All drive models that it names, each as `model_of` returns it."""
        rows = (row.drive for row in self.machines)
        names = (d.values() if isinstance(d, dict) else [d] for d in rows)
        return {model_of(self.folder, str(name)) for given in names for name in given}

    def __post_init__(self) -> None:
        if not self.machines:
            raise ValueError("there is no machine: add [machine.NAME]")
        names = [bus.name for bus in self.buses]
        for machine in self.machines:
            if machine.bus not in names:
                raise ValueError(f"machine.{machine.name}: bus = {machine.bus!r}: "
                                 f"{hint(machine.bus, names)}")
        for bus in self.buses:
            if not any(machine.bus == bus.name for machine in self.machines):
                raise ValueError(f"bus.{bus.name}: no machine is on it")

    def of(self, bus: BusRow) -> list[MachineRow]:
        """Return the machines on a bus, in the order of the file."""
        return [machine for machine in self.machines if machine.bus == bus.name]


def nodes(
    drive: str, node_ids: Sequence[int], axis: str = "linear", parameter_file: str = ""
) -> tuple[MachineRow, ...]:
    """Return a machine for each node-id; the second axis of a drive has the next node-id.

    Raises ValueError for a model without CAN, or node-ids that two machines would share.
    """
    size = len(AXES[axis][1]) if axis in AXES else 1
    step = size * load(drive, "can").axes
    served = [first + n for first in node_ids for n in range(step)]
    if len(set(served)) != len(served):
        raise ValueError(f"--node-id {[*node_ids]}: the nodes would be {served}, some twice")
    return tuple(
        MachineRow(
            f"node {node_id}", "bus", axis, drive=drive, node_id=node_id,
            parameter_file=f"{named_for(Path(parameter_file), str(node_id))}"
            if parameter_file and size == 1 < len(served) else parameter_file,
        )
        for first in node_ids for node_id in range(first, first + step, size)
    )


def model_of(folder: Path, name: str) -> str | Path:
    """Return a drive model of a machine file: a folder beside the file, else the name."""
    return folder / name if (folder / name).is_dir() else name


def read(source: str | Path | Mapping[str, Any], *, run_code: bool = False) -> Description:
    """Read the description from a file, or from a mapping of the same form.

    Raises:
        ValueError: names file, row, field and what it may be; or a file names a task of another
            module, whose code runs only with `run_code`.
    """
    if isinstance(source, Mapping):
        return _description(source, Path(), "machine file")
    path = Path(source)
    try:
        data = tomllib.loads(content(path, "a machine file").decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: {error}") from None
    found = _description(data, path.parent, str(path))
    for machine in found.machines:
        of_a_file(machine.task, str(path), run_code)
    return found


def _description(data: Mapping[str, Any], folder: Path, where: str) -> Description:
    known = ("bus", "machine", "event")
    for key in data:
        if key not in known:
            raise ValueError(f"{where}: {key!r} is unknown: {hint(str(key), known)}")
    try:
        return Description(
            tuple(_row(BusRow, f"bus.{n}", row, n) for n, row in _table(data, "bus").items()),
            tuple(
                _row(MachineRow, f"machine.{n}", row, n)
                for n, row in _table(data, "machine").items()
            ),
            tuple(
                _row(EventRow, f"event {i}", row) for i, row in enumerate(data.get("event", []), 1)
            ),
            folder,
        )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _table(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, Mapping):
        raise ValueError(f"{key}: write [{key}.NAME]")
    return table


def _row(kind: type, where: str, row: Any, name: str = "") -> Any:
    """Return a row as its dataclass after checking the types. Raises ValueError with its place."""
    try:
        if not isinstance(row, Mapping):
            raise ValueError(f"it is {row!r}, not a table")
        own = [f for f in fields(kind) if f.name != "name"]
        hints = get_type_hints(kind)
        for key, value in row.items():
            if key not in {f.name for f in own}:
                raise ValueError(f"{key!r} is unknown: {hint(str(key), [f.name for f in own])}")
            wanted = _types(hints[key])
            if isinstance(value, bool) or not isinstance(value, wanted):
                names = " or ".join(each.__name__ for each in wanted)
                raise ValueError(f"{key} = {value!r} must be {names}")
        for f in own:
            required = f.default is MISSING and f.default_factory is MISSING
            if required and f.name not in row:
                raise ValueError(f"{f.name} is missing")
        return kind(**({"name": name} if name else {}), **row)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _types(kind: Any) -> tuple[type, ...]:
    if isinstance(kind, UnionType):
        return tuple(kind for part in get_args(kind) for kind in _types(part))
    if kind is float:
        return (float, int)
    return (get_origin(kind) or kind,)
