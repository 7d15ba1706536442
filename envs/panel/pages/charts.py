"""Charts: Bode plot, velocity step, following error on a move, policies side by side."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...autotune.response import Response
from ...autotune.trial import Trial

QUIET = "#76808e"  # to be read on light and on dark ground
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
            crossover = np.argmin(np.abs(magnitude[there]))  # there it is known best
            phase -= 360 * np.round((phase[there][crossover] + 130) / 360)
            for grid, values in ((0, magnitude), (1, phase)):
                series.append(
                    _line(f"{name}, before" if old else name, response.frequencies[there],
                          values[there], colour, grid, dashed=old)
                )
    frequency = AXIS | {"type": "log", "min": 2, "minorSplitLine": {"show": False}}
    return _two(
        frequency, "frequency (Hz)", AXIS | {"type": "value", "name": "magnitude (dB)"},
        AXIS | {"type": "value", "name": "phase (°)", "interval": 90} | _turns(series), series,
    )


def step_chart(before: Trial, after: Trial) -> dict[str, Any]:
    """A step of the velocity, and the following error on the move."""
    series = []
    for name, trial, colour in (("before", before, BEFORE), ("after", after, AFTER)):
        series.append(_line(name, trial.step_time * 1e3, trial.step_velocity, colour, 0))
    return _one("velocity, share of the step", "time (ms)", series)


def move_chart(before: Trial, after: Trial, unit: str) -> dict[str, Any]:
    """The following error on a move, and the torque."""
    small, scale = SMALL[unit]
    series = []
    for name, trial, colour in (("before", before, BEFORE), ("after", after, AFTER)):
        series.append(_line(name, trial.time, trial.error * scale, colour, 0))
        series.append(_line(name, trial.time, trial.torque, colour, 1))
    value = AXIS | {"type": "value"}
    return _two(
        value, "time (s)", value | {"name": f"following error ({small})"},
        value | {"name": "torque (Nm)"}, series,
    )


def course_chart(courses: Sequence[Any], shown: str) -> dict[str, Any]:
    """The displayed quantity and the torque of several policies over time, a colour each."""
    series = []
    for course, colour in zip(courses, COLOURS, strict=False):
        series.append(_line(course.policy, course.time, course.value, colour, 0))
        series.append(_line(course.policy, course.time, course.torque, colour, 1))
    value = AXIS | {"type": "value"}
    return _two(
        value, "time (s)", value | {"name": shown, "scale": True},
        value | {"name": "torque (% rated)"}, series,
    )


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


def _one(name: str, along: str, series: list[dict[str, Any]]) -> dict[str, Any]:
    value = AXIS | {"type": "value"}
    return {
        "textStyle": FONT,
        "grid": [{"left": 64, "right": 34, "top": 76, "bottom": 55}],
        "legend": LEGEND,
        "tooltip": {"trigger": "axis"},
        "xAxis": [value | ALONG | {"name": along}],
        "yAxis": [value | {"name": name, "nameTextStyle": LEFT}],
        "series": series,
    }


def _two(
    x: dict[str, Any], along: str, upper: dict[str, Any], lower: dict[str, Any],
    series: list[dict[str, Any]],
) -> dict[str, Any]:
    left = {"nameTextStyle": LEFT}
    return {
        "textStyle": FONT,
        "grid": [{"left": 64, "right": 34, "top": 76, "bottom": "54%"},
                 {"left": 64, "right": 34, "top": "57%", "bottom": 55}],
        "legend": LEGEND,
        "tooltip": {"trigger": "axis"},
        "xAxis": [
            x | {"gridIndex": 0, "axisLabel": {"show": False}},
            x | ALONG | {"gridIndex": 1, "name": along},
        ],
        "yAxis": [upper | left | {"gridIndex": 0}, lower | left | {"gridIndex": 1}],
        "series": series,
    }
