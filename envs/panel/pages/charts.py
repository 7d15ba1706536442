"""Charts: Bode plot, velocity step, following error on a move, policies side by side."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...autotune.response import Response
from ...autotune.trial import Trial

QUIET = "#76808e"  # legible on a light and on a dark ground
VELOCITY, POSITION = "#3987e5", "#e0762b"
BEFORE, AFTER = QUIET, "#3987e5"
FONT = {"fontFamily": "Roboto, system-ui, sans-serif", "fontSize": 15}
AXIS = {
    "axisLine": {"onZero": False, "show": True, "lineStyle": {"color": "#8a94a388"}},
    "axisTick": {"lineStyle": {"color": "#8a94a388"}},
    "axisLabel": {"color": QUIET, "fontSize": 15},
    "nameTextStyle": {"color": QUIET, "fontSize": 15},
    "splitLine": {"lineStyle": {"color": "#8a94a333"}},
}
LEFT = {"color": QUIET, "align": "left", "fontSize": 15}
ALONG = {"nameLocation": "middle", "nameGap": 30}
LEGEND = {
    "top": 0, "itemWidth": 32, "itemStyle": {"opacity": 0},
    "textStyle": {"color": QUIET, "fontSize": 15},
}
COLOURS = ("#3987e5", "#e0762b", "#2f9e5f", "#c2427a")
MOST = 800  # points of a line
# top and bottom of each panel, by their number
PANELS: dict[int, list[Any]] = {1: [(76, 55)], 2: [(76, "54%"), ("57%", 55)]}
SMALL = {"m": ("µm", 1e6), "rad": ("mrad", 1e3)}


def bode_chart(responses: Sequence[Response]) -> dict[str, Any]:
    """Magnitude and phase over frequency; of two responses the first is dashed."""
    series = []
    for number, measured in enumerate(responses):
        old = len(responses) > 1 and number == 0
        low, high = measured.frequencies[0], measured.frequencies[-1]
        response = measured.wide
        there = (response.frequencies >= low) & (response.frequencies <= high)
        for name, colour, loop in (
            ("velocity", VELOCITY, response.velocity_loop),
            ("position", POSITION, response.position_loop),
        ):
            magnitude = 20 * np.log10(np.abs(loop))
            phase = np.degrees(np.unwrap(np.angle(loop)))
            crossover = np.argmin(np.abs(magnitude[there]))  # the phase is most certain there
            phase -= 360 * np.round((phase[there][crossover] + 130) / 360)
            for grid, values in ((0, magnitude), (1, phase)):
                series.append(
                    _line(f"{name}, before" if old else name, response.frequencies[there],
                          values[there], colour, grid, dashed=old)
                )
    frequency = {"type": "log", "min": 2, "minorSplitLine": {"show": False}}
    phase_axis = {"name": "phase (°)", "interval": 90} | _turns(series)
    return _panels("frequency (Hz)", [{"name": "magnitude (dB)"}, phase_axis], series, frequency)


def step_chart(before: Trial, after: Trial) -> dict[str, Any]:
    """A step of the velocity."""
    series = [
        _line(name, trial.step_time * 1e3, trial.step_velocity, colour, 0)
        for name, trial, colour in (("before", before, BEFORE), ("after", after, AFTER))
    ]
    return _panels("time (ms)", [{"name": "velocity, share of the step"}], series)


def move_chart(before: Trial, after: Trial, unit: str) -> dict[str, Any]:
    """The following error and the torque on a move."""
    small, scale = SMALL[unit]
    series = []
    for name, trial, colour in (("before", before, BEFORE), ("after", after, AFTER)):
        series.append(_line(name, trial.time, trial.error * scale, colour, 0))
        series.append(_line(name, trial.time, trial.torque, colour, 1))
    names = [{"name": f"following error ({small})"}, {"name": "torque (Nm)"}]
    return _panels("time (s)", names, series)


def course_chart(courses: Sequence[Any], shown: str) -> dict[str, Any]:
    """The displayed quantity and the torque of several policies over time, a colour each."""
    series = []
    for course, colour in zip(courses, COLOURS, strict=False):
        series.append(_line(course.policy, course.time, course.value, colour, 0))
        series.append(_line(course.policy, course.time, course.torque, colour, 1))
    names: list[Any] = [{"name": shown, "scale": True}, {"name": "torque (% rated)"}]
    return _panels("time (s)", names, series)


def _turns(series: Sequence[dict[str, Any]]) -> dict[str, float]:
    """The range of the phases, in whole quarters of a turn."""
    phases = [y for line in series if line["yAxisIndex"] == 1 for _, y in line["data"]] or [-180, 0]
    return {"min": 90 * np.floor(min(phases) / 90), "max": 90 * np.ceil(max(phases) / 90)}


def _line(
    name: str, x: np.ndarray, y: np.ndarray, colour: str, grid: int, *, dashed: bool = False
) -> dict[str, Any]:
    stride = -(-len(x) // MOST)
    points = np.stack((x, y), axis=1)[::stride].round(4).tolist()
    return {
        "name": name, "type": "line", "symbol": "none", "data": points, "xAxisIndex": grid,
        "yAxisIndex": grid, "color": colour, "animation": False,
        "lineStyle": {"width": 1.5 if dashed else 2, "type": "dashed" if dashed else "solid"},
    }


def _panels(
    along: str, values: Sequence[dict[str, Any]], series: list[dict[str, Any]],
    x: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Panels above one another with a common horizontal axis.

    Args:
        along: name of the horizontal axis.
        values: options of the vertical axis of each panel, one or two.
        series: lines of `_line`.
        x: options of the horizontal axis; a linear one by default.
    """
    last = len(values) - 1
    return {
        "textStyle": FONT, "legend": LEGEND, "tooltip": {"trigger": "axis"}, "series": series,
        "grid": [
            {"left": 64, "right": 34, "top": top, "bottom": bottom}
            for top, bottom in PANELS[len(values)]
        ],
        "xAxis": [
            AXIS | (x or {"type": "value"}) | {"gridIndex": n}
            | (ALONG | {"name": along} if n == last else {"axisLabel": {"show": False}})
            for n in range(len(values))
        ],
        "yAxis": [
            AXIS | {"type": "value", "gridIndex": n, "nameTextStyle": LEFT} | own
            for n, own in enumerate(values)
        ],
    }
