"""Speed, as ratios within one run: drive, environments, CANopen, training."""

from collections.abc import Callable, Iterable, Sequence

from rich.console import Console
from rich.table import Table

Tell = Callable[[str], object]  # takes what is being measured, for a person who waits


def show_table(
    console: Console, title: str, heading: Sequence[str], rows: Iterable[Sequence[str]],
    texts: Sequence[int] = (0,),
) -> None:
    """Print a table of numbers; the columns `texts` hold words."""
    table = Table(title=title)
    for i, column in enumerate(heading):
        table.add_column(column, justify="left" if i in texts else "right")
    for row in rows:
        table.add_row(*row)
    console.print(table)
