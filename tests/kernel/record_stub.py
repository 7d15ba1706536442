"""Write drive/kernel/record/__init__.pyi from the tables of the record: the fields as types.

``python tests/kernel/record_stub.py`` (or ``make stub``) after a change of the fields.
"""

from pathlib import Path

from servogym.drive.kernel import record

PATH = Path(__file__).parents[2] / "drive" / "kernel" / "record" / "__init__.pyi"
HEAD = '''"""Types of the record, written by `make stub`. Not to be edited.

Scalars stand as int and float: what the control cycle computes with.
"""

from typing import Any

import numpy as np

from .quantity import Kind as Kind, Quantity as Quantity

'''
TAIL = """
Row = tuple[str, str | tuple[str, tuple[int, ...]], str, str]
OBJECTS: tuple[Quantity, ...]
QUIRKS: tuple[Row, ...]
FIELDS: tuple[Row, ...]
PLACES: dict[str, int]
RAD_S_PER_MINUTE: float
SIZES: dict[str, float | str]
OD: np.dtype
AXIS: np.dtype
UNITS: dict[str, str]

def accessible(dtype: np.dtype) -> np.dtype: ...
def make(n: int) -> np.ndarray: ...
"""


def _kind(kind):
    if isinstance(kind, tuple):
        return "np.ndarray"
    return "float" if "f" in kind else "int"


def _class(name, doc, rows, before=""):
    lines = [f"\nclass {name}:", f'    """{doc}"""\n']
    if before:
        lines.append(before)
    for field, kind, unit, meaning, *_ in rows:
        shape = f"{kind[1][0]} values" if isinstance(kind, tuple) else ""
        about = "; ".join(part for part in (shape, unit, meaning) if part)
        lines.append(f"    {field}: {_kind(kind)}")
        if about:
            lines.append(f'    """{about}"""')
    lines += ["    def __getitem__(self, field: str) -> Any: ..."]
    lines += ["    def __setitem__(self, field: str, value: Any) -> None: ..."]
    return "\n".join(lines) + "\n"


def text():
    """What the stub has to be."""
    constants = [f"{n}: int" for n, v in vars(record).items() if n.isupper() and type(v) is int]
    return (
        HEAD
        + "\n".join(constants)
        + "\n"
        + _class("Objects", "`AXIS.od`: the object dictionary's variables.", record.OBJECTS)
        + _class(
            "Axis",
            "One servo axis: its objects in drive units, all else in SI at the motor shaft.",
            record.FIELDS,
            "    od: Objects",
        )
        + TAIL
    )


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")
