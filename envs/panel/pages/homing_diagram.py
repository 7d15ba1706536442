"""The diagram of a homing method, as manuals draw it: the travel, the switches, the pulses."""

from collections.abc import Mapping

from ....drive.diagrams import NEGATIVE, POSITIVE, Method, home_switch, homing_path

LEFT, WIDTH, ROW = 20, 400, 26
STARTS = (0.25, 0.5, 0.75)
PAST = 0.022  # by which the drawing passes an edge, so that the turn is visible


def homing_svg(method: int, own: Mapping[int, Method] | None = None) -> str:
    """The diagram as SVG text; `own` contains the methods of the model's homing.csv."""
    paths = [homing_path(method, start, own) for start in STARTS]
    here = all(len(path) == 1 for path in paths)
    runs = paths[:1] if here else paths
    y = 44 + sum(ROW + 8 * len(path) for path in runs)
    switches = max(y - 8, 168)
    indexed = method < 17 or method in (33, 34)
    tall = switches + 58 + 26 * indexed
    parts = [f'<svg viewBox="0 0 440 {tall}" class="homing" role="img" '
             f'aria-label="Paths of homing method {method}">']
    parts += [_line(LEFT, 20, LEFT + WIDTH, 20, "rail")]
    for end in (0.0, 1.0):
        parts.append(f'<rect x="{_x(end) - 3}" y="10" width="6" height="20" class="stop"/>')
    y = 44
    for number, path in enumerate(runs):
        parts.append(_path(path, y, number))
        y += ROW + 8 * len(path)
    y = switches
    low, high = home_switch(method)
    for name, begin, end in (
        ("negative limit", 0.0, NEGATIVE),
        ("home switch", low, high),
        ("positive limit", POSITIVE, 1.0),
    ):
        begin, end = max(begin, 0.0), min(end, 1.0)
        parts.append(
            f'<rect x="{_x(begin)}" y="{y}" width="{_x(end) - _x(begin)}" height="8" class="on"/>'
        )
        parts.append(_line(LEFT, y + 8, LEFT + WIDTH, y + 8, "base"))
        anchor = "end" if begin > 0.8 else "start"
        at = _x(begin) - 6 if begin > 0.8 else _x(end) + 6
        parts.append(f'<text x="{at}" y="{y + 5}" text-anchor="{anchor}">{name}</text>')
        y += 18
    if indexed:
        parts += [_line(_x(n / 24), y, _x(n / 24), y + 8, "pulse") for n in range(1, 24)]
        parts.append(f'<text x="{LEFT}" y="{y + 20}">index pulses</text>')
    parts.append("</svg>")
    return "".join(parts)


def _x(place: float) -> float:
    return round(LEFT + place * WIDTH, 1)


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    return f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" class="{kind}"/>'


def _path(path: list[float], y: float, number: int) -> str:
    """The path of one run, step by step downwards."""
    if not path:
        return ""
    at, points = path[0], [(_x(path[0]), y)]
    for step, place in enumerate(path[1:], 1):
        last = step == len(path) - 1
        direction = 1 if place > at else -1
        if place == at and step > 1:  # it turns where it stands
            direction = 1 if at < path[step - 2] else -1
        turn = place if last else min(max(place + direction * PAST, 0.004), 0.996)
        points += [(_x(turn), points[-1][1]), (_x(turn), points[-1][1] + 8)]
        at = place
    drawn = " ".join(f"{x},{height:g}" for x, height in points[:-1])
    x, height = points[-2] if len(points) > 1 else points[0]
    return (
        f'<g class="run run-{number}"><circle cx="{points[0][0]}" cy="{y}" r="3.5"/>'
        f'<polyline points="{drawn}"/>'
        f'<path d="M{x - 5} {height + 11} L{x + 5} {height + 11} L{x} {height + 3} z"/></g>'
    )
