"""What `servogym bench --can` measures is what it says; how fast it is, no test can promise."""

import json

import pytest

from servogym.training import cli
from servogym.training.bench import can as can_bench
from servogym.training.bench import sdo as sdo_bench

canopen = pytest.importorskip("canopen")


def test_both_servers_answer_all_clients():
    results = sdo_bench.measure(2)  # raises where an answer is missing
    assert results.keys() == {"handling", "raw_loop", "sdo_client", "one_thread"}
    for result in results.values():
        ratio = result["servogym_per_s"] / result["canopen_per_s"]
        assert result["ratio"] == pytest.approx(ratio)
        assert 0.0 <= result["servogym_others_share"] < 1.0
    assert results["handling"]["servogym_others_share"] == 0.0


def test_drives_in_lock_step_are_enabled_and_exchange_all_frames():
    result = can_bench.lockstep(2, 20)  # raises where a drive is not enabled or a frame is missing
    assert result["frames_per_sync"] == 1 + 2 * 4
    assert result["times_real_time"] > 0.0
    assert 0.5 < result["load_at_1_mbit_s"] < 1.3


def test_the_results_come_as_json(capsys):
    assert cli.main(["bench", "--can", "--repeat", "1", "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results["canopen"] == canopen.__version__
    assert results["lockstep"]["drives"] == 8


def test_without_canopen_the_next_step_is_told(monkeypatch):
    monkeypatch.setattr(sdo_bench, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match="pip install canopen"):
        sdo_bench.measure(1)
