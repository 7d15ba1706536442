"""A benchmark others can enter: suites, submissions as one file, the check from the weights."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from servogym.envs.environment.registry import task
from servogym.training import cli
from servogym.training.evaluate import comparison, leaderboard, suite
from servogym.training.evaluate.submission import FILES, HEAD, fits, read, write
from servogym.training.policies import SHIPPED

SMALL = """
version = "small"
drive = "generic"
seed = 181
episodes = 1
conditions = ["nominal"]

[tasks.LinearAxis-v0]
held_out = { payload = [7.5, 15.0] }
conditions = ["nominal", "held_out"]
"""
ONE = str(SHIPPED / "LinearAxis-v0" / "seed_1")
RESULTS = "results", "entries", "--suite", "small.toml"
CST = 'conditions = ["nominal", "drive=kollmorgen_akd"]'


ROOT = Path(__file__).parents[2]


def test_the_committed_leaderboard_is_of_the_committed_entries():
    """Whether their weights give these values `servogym results` has told, which wrote the page."""
    found, v2 = Path("assets", "suites", "v2"), suite.read("v2")
    entries = {path.stem: read(path) for path in sorted((ROOT / found).glob("*.npz"))}
    for name, entry in entries.items():
        assert entry.name == name
        fits(Path(name), entry, v2)
        assert entry.fitted == entry.fitted_here
    assert {env for entry in entries.values() for env in entry.table} == {*v2.parts}
    committed = (ROOT / "docs" / "results" / "leaderboard.md").read_text(encoding="utf-8")
    command = f"servogym results {found.as_posix()} --suite v2 -o out/leaderboard.md"
    assert leaderboard.page(v2, entries, command) == committed


@pytest.fixture
def small(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    (tmp_path / "entries").mkdir()
    return tmp_path


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Bytes of two submissions: one that was trained, and hold."""
    folder = tmp_path_factory.mktemp("played")
    (folder / "small.toml").write_text(SMALL, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert entered(ONE, "--entry", "mine") == 0
        assert entered("hold") == 0
    return {name: (folder / "entries" / f"{name}.npz").read_bytes() for name in ("mine", "hold")}


@pytest.fixture
def entries(small, played):
    for name, data in played.items():
        (small / "entries" / f"{name}.npz").write_bytes(data)
    return small / "entries"


def entered(policy, *more, out="entries"):
    words = ["benchmark", "learned", "--suite", "small.toml", "--policy", policy, "--out", out]
    return cli.main([*words, *more])


def refused(capsys, *words):
    assert cli.main([*words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1, error
    return error


def changed(path, **members):
    """The file with other bytes under some names."""
    with np.load(path) as found:
        kept = {name: found[name] for name in found.files}
    kept |= {name: np.frombuffer(data, np.uint8) for name, data in members.items()}
    np.savez(path, **kept)


def head(path):
    with np.load(path) as found:
        return json.loads(found[HEAD].tobytes())


def test_the_suites_have_the_eight_tasks_with_ranges_held_out():
    assert suite.versions() == ["v1", "v2"]
    for found in map(suite.read, suite.versions()):
        assert len(found.parts) == 8
        for part in found.parts.values():
            assert {"nominal", "held_out"} < {row.name for row in part.rows}


def test_suite_v2_draws_the_episodes_of_an_entry_from_its_hash():
    found = suite.read("v2")
    assert found.seed is None
    seeds = [found.drawn(f"{k:064x}"[::-1]).seed for k in (1, 2, 1)]
    assert seeds[0] == seeds[2] != seeds[1]


def test_a_submission_is_checked_from_its_weights_and_ranked(entries):
    made = read(entries / "mine.npz")
    files = {f"LinearAxis-v0/seed_1/{name}" for name in ("checkpoint.json", "weights.npz")}
    assert set(made.files) == files
    weights = (SHIPPED / "LinearAxis-v0" / "seed_1" / "weights.npz").read_bytes()
    assert made.files["LinearAxis-v0/seed_1/weights.npz"] == weights
    by_hand = comparison.evaluate(
        "LinearAxis-v0", [ONE], "generic", 1, 181, {"randomise": {"payload": (7.5, 15.0)}}
    )[0]
    told = made.table["LinearAxis-v0"]["held_out"]["settling_time"]
    assert told == [by_hand.values["settling_time"].tolist()]
    write(entries / "again.npz", made)
    assert (entries / "again.npz").read_bytes() == (entries / "mine.npz").read_bytes()
    (entries / "again.npz").unlink()
    assert cli.main([*RESULTS]) == 0
    page = (entries / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| (mine|hold) \| (\d) \|", page, re.M) == [("mine", "1"), ("hold", "2")]
    assert made.identity[:12] in page


def test_a_stranger_checks_an_entry_of_one_training_folder_from_the_file_alone(
    tmp_path, monkeypatch, capsys
):
    """Episodes of its own, the training gone, another folder, nothing but the entry and suite."""
    hidden = SMALL.replace("seed = 181", 'seed = "of_submission"')
    hidden = hidden.replace('"nominal", "held_out"]', '"nominal"]')
    author, stranger = tmp_path / "author", tmp_path / "stranger"
    for place in (author, stranger):
        place.mkdir()
        (place / "small.toml").write_text(hidden, encoding="utf-8")
    monkeypatch.chdir(author)
    shutil.copytree(ONE, "my_run")
    assert entered("my_run", "--entry", "mine", out="sent") == 0
    shutil.copytree(author / "sent", stranger / "received")
    shutil.rmtree(author)
    monkeypatch.chdir(stranger)
    capsys.readouterr()
    words = ["results", "received", "--suite", "small.toml", "-o", "board.md"]
    assert cli.main(words) == 0, capsys.readouterr().err
    made = read(stranger / "received" / "mine.npz")
    board = Path("board.md").read_text(encoding="utf-8")
    assert "drawn for each entry from its hash" in board
    assert f"`{made.identity[:12]}`" in board
    row = next(line for line in board.splitlines() if line.startswith("| mine | 1 |"))
    value = np.mean(made.table["LinearAxis-v0"]["nominal"]["episode_return"])
    assert f" {value:.0f} " in row or f" {value:.1f} " in row


def test_a_public_text_draws_the_same_episodes_for_all_and_no_byte_of_an_entry_changes_them(
    small, capsys
):
    """Who hands in many copies of a policy with other bytes in each meets the same episodes."""
    hidden = SMALL.replace("seed = 181", 'seed = "of_submission"')
    (small / "small.toml").write_text(hidden, encoding="utf-8")
    seed = suite.read("small.toml").announced("7 11 23").seed
    assert suite.read("small.toml").announced("7 11 24").seed != seed
    by_hand = {}
    for name in ("trapezoid", "jerk_limited"):
        assert entered(name) == 0
        played = comparison.evaluate("LinearAxis-v0", [name], "generic", 1, seed, {})[0]
        by_hand[name] = played.values["settling_time"].item()
    assert cli.main([*RESULTS, "--public", "7 11 23", "-o", "board.md"]) == 0
    board = Path("board.md").read_text(encoding="utf-8")
    assert "drawn from the public text `7 11 23`" in board
    assert "--suite small.toml --public '7 11 23' -o board.md`, which wrote this page" in board
    for name, value in by_hand.items():
        row = next(line for line in board.splitlines() if line.startswith(f"| {name} |"))
        assert f" {value:.3f} [" in row
    assert "letters, digits" in refused(capsys, *RESULTS, "--public", "7 | 11")
    assert "add --suite" in refused(capsys, "results", "entries", "--public", "7")
    (small / "small.toml").write_text(SMALL, encoding="utf-8")
    assert "has the seed 181" in refused(capsys, *RESULTS, "--public", "7")


def test_weights_that_give_other_numbers_are_told_and_the_others_ranked(entries, capsys):
    file = entries / "mine.npz"
    other = SHIPPED / "LinearAxis-v0" / "seed_2"
    about = json.loads((other / "checkpoint.json").read_text(encoding="utf-8")) | {"seed": 1}
    name = f"{FILES}LinearAxis-v0/seed_1/"
    changed(file, **{f"{name}weights.npz": (other / "weights.npz").read_bytes()})
    changed(file, **{f"{name}checkpoint.json": json.dumps(about).encode()})
    real = re.search(r"mine.npz: its hash .* its content has (\w+)", refused(capsys, *RESULTS))[1]
    changed(file, **{HEAD: json.dumps(head(file) | {"hash": real}).encode()})
    error = refused(capsys, *RESULTS)
    assert "mine.npz, LinearAxis-v0, nominal: its table says return" in error
    assert "it plays" in error
    page = (entries / "README.md").read_text(encoding="utf-8")
    assert "| hold | 1 |" in page
    assert "mine" not in page


def test_a_condition_a_policy_does_not_fit_is_a_gap_that_earns_nothing(small):
    text = SMALL.replace('conditions = ["nominal", "held_out"]', CST)
    (small / "small.toml").write_text(text, encoding="utf-8")
    assert entered("pd") == 0
    table = read(small / "entries" / "pd.npz").table["LinearAxis-v0"]
    assert table["drive=kollmorgen_akd"] == {}
    chosen = suite.read("small.toml")
    line = leaderboard._lines(chosen, "LinearAxis-v0", {"pd": {"nominal": table["nominal"]}})
    own = leaderboard.cell(task("LinearAxis-v0"), table["nominal"]).earned.iqm
    assert f"| pd | 1 | {own / 2:.1f} | 50 % |" in line
    assert line.rstrip().endswith("| gap |")


def test_a_program_is_run_only_for_who_says_so(small, capsys):
    (small / "still.py").write_text("def act(seen):\n    return [0.0]\n", encoding="utf-8")
    assert entered("still.py:act", "--entry", "still") == 0
    (small / "still.py").unlink()
    assert "brings still.py, which is a program: read it, and say --run-code" in refused(
        capsys, *RESULTS
    )
    assert cli.main([*RESULTS, "--run-code"]) == 0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"held_out"]', '"wind"]', "there is no condition 'wind'"),
        ("payload = [", "weight = [", "held_out: "),
        ("seed = 181", "", "lacks seed"),
        ("LinearAxis-v0", "LinearAxis-v9", "did you mean LinearAxis-v0"),
        ('["nominal", "held_out"]', '["held_out"]', "conditions lack 'nominal'"),
        ("episodes = 1", "episodes = 0", "--episodes = 0 is out of range"),
        ("episodes = 1", 'episodes = "1"', "episodes = '1' has to be a int"),
        ("[tasks", "[[tasks", "suite small.toml"),
    ],
)
def test_a_suite_that_makes_no_sense_is_one_line(old, new, says, small, capsys):
    (small / "small.toml").write_text(SMALL.replace(old, new), encoding="utf-8")
    error = refused(capsys, "benchmark", "learned", "--suite", "small.toml", "--policy", "hold")
    assert says in error


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("benchmark learned --suite v9", "there is no suite 'v9'"),
        ("benchmark learned --suite small.toml --tasks Homing-v0", "has no task 'Homing-v0'"),
        ("benchmark learned --suite small.toml --conditions wind", "has no condition 'wind'"),
        ("benchmark learned --suite small.toml --policy squaring", "is for servogym/GantrySync"),
        ("benchmark learned --suite small.toml --policy hold --entry ../x", "--entry '../x'"),
        ("benchmark learned --suite small.toml --drive generic", "is not for suites"),
        ("benchmark homing --suite v1", "--suite is for `servogym benchmark learned`"),
        ("results --suite small.toml", "name the folder of the submissions"),
        ("results . --suite small.toml", "has no submission"),
    ],
)
def test_wrong_words_are_one_line(words, says, small, capsys):
    assert says in refused(capsys, *words.split())


def test_what_is_no_submission_is_told(entries, capsys):
    def says(data, **members):
        for name in ("mine", "hold"):
            (entries / f"{name}.npz").unlink(missing_ok=True)
        file = entries / "hold.npz"
        file.write_bytes(data)
        if members:
            changed(file, **members)
        return refused(capsys, *RESULTS)

    good = (entries / "hold.npz").read_bytes()
    told = head(entries / "hold.npz")
    assert "holds no arrays" in says(b"hello")
    assert "is not a submission" in says(good, **{HEAD: b"{}"})
    assert "its hash is" in says(good, **{HEAD: json.dumps(told | {"suite": "v0"}).encode()})
    assert "'../evil' is not a file of a policy" in says(good, **{FILES + "../evil": b"x"})
    (entries.parent / "small.toml").write_text(SMALL + "\n# more\n", encoding="utf-8")
    assert "make it again with --suite small" in says(good)


@pytest.mark.parametrize(
    ("about", "says"),
    [
        ({"algorithm": "Popen"}, "algorithm 'Popen' is unknown"),
        ({"residual": "evil.py:act"}, "corrects 'evil.py:act', which is not a registered policy"),
    ],
)
def test_a_checkpoint_that_names_foreign_code_is_refused(about, says, entries):
    file, name = entries / "mine.npz", "LinearAxis-v0/seed_1/checkpoint.json"
    found = json.loads(read(file).files[name]) | about
    changed(file, **{FILES + name: json.dumps(found).encode()})
    with pytest.raises(ValueError, match=says):
        read(file)
