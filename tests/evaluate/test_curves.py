"""`servogym curves`: what trainings have in common, drawn."""

import numpy as np
import pytest

from servogym.training import cli
from servogym.training.evaluate import curves


def training(folder, steps, base):
    folder.mkdir(parents=True)
    results = np.array([[base + step / 100 + k for k in range(4)] for step in steps])
    np.savez(folder / curves.FILE, timesteps=steps, results=results)


def test_trainings_are_drawn_where_all_were_evaluated(tmp_path, capsys):
    training(tmp_path / "seed_1", [100, 200, 300], 1.0)
    training(tmp_path / "seed_2", [200, 300, 400], 2.0)
    steps, runs = curves.read(tmp_path)
    assert steps.tolist() == [200, 300]
    assert [run[:, 0].tolist() for run in runs] == [[3.0, 4.0], [4.0, 5.0]]
    out = tmp_path / "pictures" / "curves.png"
    assert cli.main(["curves", str(tmp_path), "-o", str(out)]) == 0
    assert out.stat().st_size > 10_000
    assert "2 trainings, 2 evaluations" in capsys.readouterr().out


def test_a_single_training_is_drawn_too(tmp_path):
    training(tmp_path / "run", [10, 20], 0.0)
    assert len(curves.read(tmp_path / "run")[1]) == 1


def test_a_second_stage_is_drawn_over_its_own_range(tmp_path, monkeypatch):
    """Returns of 1000 to 1006 are not a flat line at the top."""
    seen = []
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig", lambda self, *_, **__: seen.append(self.axes[0])
    )
    training(tmp_path / "run", [100, 200, 300], 1000.0)
    assert cli.main(["curves", str(tmp_path / "run"), "-o", str(tmp_path / "curves.png")]) == 0
    low, high = seen[0].get_ylim()
    assert 990.0 < low < high < 1020.0


@pytest.mark.parametrize("make", [lambda path: None, lambda path: (
    training(path / "seed_1", [1], 0.0), training(path / "seed_2", [2], 0.0))])
def test_nothing_in_common_is_one_line(make, tmp_path, capsys):
    make(tmp_path)
    assert cli.main(["curves", str(tmp_path)]) == 2
    assert "servogym train" in capsys.readouterr().err
