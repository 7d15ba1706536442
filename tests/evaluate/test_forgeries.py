"""Submissions that were forged with the right hash: each is refused, and the reason is said.

The forger has the source: he writes what he likes and seals it as `submission.write` does.
"""

import copy
import hashlib
import io
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_benchmark import ONE, RESULTS, SMALL, entered, refused

from servogym.drive.model import foreign
from servogym.envs import ON_MODELS, TASKS
from servogym.training import cli
from servogym.training.evaluate import submission as format_of
from servogym.training.evaluate import suite
from servogym.training.policies import (
    POLICIES,
    SHIPPED,
    basis_feed_forward,
    fitted,
    make,
    names,
    needed,
)
from servogym.training.policies import numbers as numbers_of
from servogym.training.policies.numbers import tuned

TASK, ABOUT, WEIGHTS = "LinearAxis-v0", "checkpoint.json", "weights.npz"
FIRST = f"{TASK}/seed_1"
HELD_OUT = 1_180_000  # of suite v1: seed 180


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    """The head and the files of a submission that was trained."""
    folder = tmp_path_factory.mktemp("honest")
    (folder / "small.toml").write_text(SMALL, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert entered(ONE, "--entry", "mine") == 0
        made = format_of.read(folder / "entries" / "mine.npz")
    return {name: getattr(made, name) for name in format_of.KEYS if name != "hash"}, made.files


@pytest.fixture
def forge(honest, tmp_path, monkeypatch):
    """Writes a forged entry and returns what `servogym results` says of it."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL, encoding="utf-8")

    def forge(change, capsys, *words):
        head, files = copy.deepcopy(honest[0]), dict(honest[1])
        change(head, files)
        made = format_of.Submission(**head, files=files)
        format_of.write(Path("entries") / "forged.npz", made)
        return refused(capsys, *RESULTS, *words)

    return forge


def about(files, place=FIRST, **changes):
    """Other words in a checkpoint."""
    name = f"{place}/{ABOUT}"
    files[name] = json.dumps(json.loads(files[name]) | changes).encode()


def test_the_honest_one_is_ranked(honest, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL, encoding="utf-8")
    made = format_of.Submission(**honest[0], files=dict(honest[1]))
    format_of.write(Path("entries") / "mine.npz", made)
    assert cli.main([*RESULTS]) == 0
    page = Path("entries", "README.md").read_text(encoding="utf-8")
    assert "| mine | 1 |" in page
    assert "| mine | `PPO` | 1 | " in page


def returns(head, condition="nominal"):
    return head["table"][TASK][condition]["episode_return"]


def scaled(head, files):
    head["table"][TASK]["held_out"]["episode_return"] = [[1.0095 * returns(head, "held_out")[0][0]]]


def last_bit(head, files):
    returns(head)[0][0] = float(np.nextafter(returns(head)[0][0], np.inf))


def more_episodes(head, files):
    returns(head)[0].append(200.0)


def no_numbers(head, files):
    head["table"][TASK]["nominal"]["episode_return"] = "200"


def another_column(head, files):
    head["table"][TASK]["nominal"]["score"] = [[1.0]]


def without_the_hard_condition(head, files):
    del head["table"][TASK]["held_out"]


def empty(head, files):
    head["table"] = {}


def other_weights(head, files):
    other = SHIPPED / TASK / "seed_2"
    files[f"{FIRST}/{WEIGHTS}"] = (other / WEIGHTS).read_bytes()
    about(files, sha256=json.loads((other / ABOUT).read_text()).get("sha256"))
    found = json.loads(files[f"{FIRST}/{ABOUT}"])
    files[f"{FIRST}/{ABOUT}"] = json.dumps({k: v for k, v in found.items() if v}).encode()


def one_training_as_two(head, files):
    for part in (ABOUT, WEIGHTS):
        files[f"{TASK}/seed_2/{part}"] = files[f"{FIRST}/{part}"]
    about(files, f"{TASK}/seed_2", seed=2)


def reweighed(files, change, place=FIRST):
    """Other arrays, with the checksum of their file."""
    name, packed = f"{place}/{WEIGHTS}", io.BytesIO()
    arrays = foreign.arrays(files[name])
    change(arrays)
    np.savez_compressed(packed, **arrays)
    files[name] = packed.getvalue()
    about(files, place, sha256=hashlib.sha256(files[name]).hexdigest())


def as_two(change):
    """One training as two, with the right table, the second with weights that play the same."""

    def forged(head, files):
        one_training_as_two(head, files)
        reweighed(files, change, f"{TASK}/seed_2")
        for values in head["table"][TASK].values():
            values.update({metric: 2 * rows for metric, rows in values.items()})

    forged.__name__ = change.__name__
    return forged


def another_critic(arrays):
    arrays.update({name: a + 1 for name, a in arrays.items() if "value_net" in name})


def an_array_that_nothing_reads(arrays):
    arrays["network/nothing"] = np.ones(3, np.float32)


def neurons_in_another_order(arrays):
    layer = "network/mlp_extractor.policy_net"
    for name in (f"{layer}.0.weight", f"{layer}.0.bias"):
        arrays[name] = arrays[name][::-1]
    arrays[f"{layer}.2.weight"] = arrays[f"{layer}.2.weight"][:, ::-1]


def arrays_of(name, make):
    def forged(head, files):
        reweighed(files, lambda arrays: arrays.update(
            mean=make(int(arrays["shape"][0])), variance=np.ones(int(arrays["shape"][0]))))

    forged.__name__ = name
    return forged


def stated(**words):
    def forged(head, files):
        about(files, **words)

    forged.__name__ = f"stated {words}"
    return forged


def named(name):
    def forged(head, files):
        head["name"] = name

    forged.__name__ = f"named {name[:10]}"
    return forged


def written_backwards(head, files):
    head["command"] = "servogym benchmark learned \u202e dewarb"


def seed_of_a_suite(head, files):
    for part in (ABOUT, WEIGHTS):
        files[f"{TASK}/seed_{HELD_OUT}/{part}"] = files.pop(f"{FIRST}/{part}")
    about(files, f"{TASK}/seed_{HELD_OUT}", seed=HELD_OUT)


def seed_of_a_suite_in_a_vector(head, files):
    about(files, seed=1, start=json.loads(files[f"{FIRST}/{ABOUT}"])
          | {"seed": HELD_OUT - 1_000, "envs": 200_000})


def another_seed_than_its_folder(head, files):
    about(files, seed=2)


def a_limit_corrected_by_nothing(head, files):
    about(files, residual="informed_ruckig", bounds=[0.0])


def a_program_as_base(head, files):
    files["evil.py"] = b"open('ran.txt', 'w')\n"
    about(files, residual="evil.py:act", bounds=[0.1])


def a_program_beside(head, files):
    files["evil.py"] = b"open('ran.txt', 'w')\n"


def a_program(head, files):
    files.clear()
    files["evil.py"] = b"open('ran.txt', 'w')\ndef act(seen):\n    return [0.0]\n"
    head["policy"] = "evil.py:act"


def a_path_without_files(head, files):
    files.clear()
    Path("evil.py").write_text("open('ran.txt', 'w')\n", encoding="utf-8")
    head["policy"] = "evil.py:act"


def what_comes_with_the_laboratory(head, files):
    files.clear()
    head["policy"] = "learned"


def a_name_that_is_a_baseline(head, files):
    head["name"] = "ruckig"


def a_name_with_markup(head, files):
    head["name"] = "mine | 1 | 200"


def a_command_with_markup(head, files):
    head["command"] = "servogym benchmark learned ` | 1 | 200 |"


def an_earlier_version(head, files):
    head["versions"] = head["versions"] | {"mujoco": "3.0.0"}


def without_versions(head, files):
    head["versions"] = {}


def of_another_suite(head, files):
    head["digest"] = "0" * 16


def of_another_task(head, files):
    about(files, env_id="servogym/LinearAxisTracking-v0")


def a_tensor_of_objects(head, files):
    about(files, sha256="0" * 64)


def other_numbers(head, files):
    files.clear()
    head |= {"policy": "tuned_ruckig", "fitted": "0" * 64}


def without_its_numbers(head, files):
    files.clear()
    head["policy"] = "basis_feed_forward"


def a_base_with_other_numbers(head, files):
    about(files, residual="tuned_ruckig", bounds=[0.01])


def half_a_training(head, files):
    del files[f"{FIRST}/{WEIGHTS}"]


def out_of_its_folder(head, files):
    files["../../evil"] = b"x"


FORGERIES = {
    scaled: "held_out: its table says return",
    last_bit: "nominal: its table says return",
    more_episodes: "of the shape (1, 2), it plays (1, 1)",
    no_numbers: "of the shape (), it plays (1, 1)",
    another_column: "its table has other columns",
    without_the_hard_condition: "its table lacks held_out",
    empty: "its table is empty",
    other_weights: "its table says return",
    one_training_as_two: "plays every episode as another one does, to the bit: each training",
    as_two(another_critic): "plays every episode as another one does, to the bit",
    as_two(an_array_that_nothing_reads): "plays every episode as another one does, to the bit",
    arrays_of("dates", lambda n: np.zeros(n, "M8[D]")): "elements of datetime64[D], no numbers",
    arrays_of("texts", lambda n: np.full(n, "a")): "elements of <U1, no numbers",
    arrays_of("complex", lambda n: np.ones(n) * 1j): "elements of complex128, no numbers",
    arrays_of("too few", lambda n: np.ones(n - 1)): "numbers each",
    stated(steps=-5): "steps = -5 must be a whole number",
    stated(steps=10**400): "must be a whole number",
    stated(cpu_seconds=float("nan")): "cpu_seconds = nan is out of range",
    stated(cpu_seconds=-5.0): "cpu_seconds = -5.0 is out of range",
    stated(hyperparameters={"policy_kwargs": {"net_arch": [10**9], "ortho_init": False}}):
        "a layer has at most 4096 neurons",
    stated(residual="ruckig", bounds=[1e-300]): "corrects 'ruckig' by nothing",
    stated(seed=10**18): "seed = 1000000000000000000 must be a whole number",
    named("ruckig "): "is none that a page could show",
    named("Ruckig"): "has to be the policy of that name",
    named("ru\u0441kig"): "is none that a page could show",
    named("a" * 5000): "is none that a page could show",
    written_backwards: "is none that a page could show",
    seed_of_a_suite: "meets the episodes of evaluations and suites",
    seed_of_a_suite_in_a_vector: "meets the episodes of evaluations and suites",
    another_seed_than_its_folder: "states the seed 2, its folder another one",
    a_limit_corrected_by_nothing: "corrects 'informed_ruckig' by nothing",
    a_program_as_base: "a program is one file",
    a_program_beside: "a program is one file",
    a_program: "brings evil.py, which is a program: read it, and say --run-code",
    a_path_without_files: "brings no files, and 'evil.py:act' is not a baseline",
    what_comes_with_the_laboratory: "brings no files, and 'learned' is not a baseline",
    a_name_that_is_a_baseline: "an entry 'ruckig' has to be the policy of that name",
    a_name_with_markup: "name = 'mine | 1 | 200' is none that a page could show",
    a_command_with_markup: "is none that a page could show",
    an_earlier_version: "was made with mujoco 3.0.0, this is",
    without_versions: "versions lack python",
    of_another_suite: "is of suite small (0000000000000000), this is small",
    of_another_task: "was trained for servogym/LinearAxisTracking-v0, not for LinearAxis-v0",
    a_tensor_of_objects: "was changed or damaged: its SHA-256 is",
    other_numbers: "was made with other fitted numbers of tuned_ruckig than come with this",
    without_its_numbers: "was made with other fitted numbers of basis_feed_forward than come",
    a_base_with_other_numbers: "was made with other fitted numbers of PPO on tuned_ruckig than",
    half_a_training: "is there without its weights.npz",
    out_of_its_folder: "is not a file of a policy",
}


@pytest.mark.parametrize("change", FORGERIES, ids=lambda change: change.__name__)
def test_a_forgery_is_refused_with_the_reason(change, forge, capsys):
    assert FORGERIES[change] in forge(change, capsys)
    assert not Path("ran.txt").exists()
    assert not Path("entries", "README.md").exists()


OPENED = []  # files, while a test listens
sys.addaudithook(lambda event, given: OPENED.append(str(given[0])) if event == "open" else None)


@pytest.mark.parametrize("env", [*TASKS, *ON_MODELS], ids=lambda env: env.ID)
def test_what_a_row_reads_from_a_file_is_in_the_hash_of_its_entry(env):
    """The hash stayed when the numbers of a tuned row were edited."""
    one = env()
    observation, info = one.reset(seed=1)
    for name in names(one):
        if name not in POLICIES or needed(name):
            continue
        tuned.cache_clear()
        basis_feed_forward.fitted.cache_clear()
        OPENED.clear()
        policy = make(name, one)
        if hasattr(policy, "reset"):
            policy.reset(observation, info)
        read = [path for path in OPENED if Path(path).is_relative_to(SHIPPED)]
        assert bool(read) == bool(fitted(name)), (name, read)


@pytest.mark.parametrize("policy", ["tuned_ruckig", "tuned_ruckig below a correction", "program"])
def test_other_numbers_are_another_hash(policy, honest, tmp_path, monkeypatch):
    head, files = copy.deepcopy(honest[0]), dict(honest[1])
    if policy == "program":
        a_program(head, files)
    elif policy == "tuned_ruckig":
        files.clear()
        head["policy"] = policy
    else:
        about(files, residual="tuned_ruckig", bounds=[0.01])

    def identity():
        tuned.cache_clear()
        made = format_of.Submission(**head, files=files)
        return replace(made, fitted=made.fitted_here).identity

    before = identity()
    numbers = json.loads(numbers_of.FILE.read_text(encoding="utf-8"))
    numbers["tuned_ruckig"]["LinearAxis-v0"]["numbers"]["share"] += 0.001
    (tmp_path / "tuned.json").write_text(json.dumps(numbers), encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(numbers_of, "FILE", tmp_path / "tuned.json")
        assert identity() != before
    assert identity() == before


def test_a_base_of_another_package_is_no_entry(honest, forge, tmp_path, capsys):
    """Its program is in no hash: it could look at what was drawn, and had rank 1."""
    info = tmp_path / "site" / "cheat-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: cheat\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[servogym.policies]\nmine = cheat:act\n")
    (info.parent / "cheat.py").write_text("open('ran.txt', 'w')\ndef act(seen):\n    return [0]\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(info.parent))
        corrects = stated(residual="mine", bounds=[0.01])
        assert "corrects 'mine' of another package, whose program" in forge(corrects, capsys)
    assert not Path("ran.txt").exists()


@pytest.mark.parametrize("base", ["ruckig", "informed_ruckig"])
def test_what_the_leaderboard_refuses_is_not_sealed_as_an_entry(base, forge, tmp_path, capsys):
    """It was played, written and told its hash, and refused by whoever it was sent to."""
    shutil.copytree(SHIPPED / TASK / "seed_1", tmp_path / "nothing")
    file = tmp_path / "nothing" / ABOUT
    changes = {"residual": base, "bounds": [0.0]}
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))
    assert entered("nothing") == 2
    assert f"corrects {base!r} by nothing" in capsys.readouterr().err
    assert not Path("entries").exists()


def test_the_same_policy_under_two_names_is_one_entry(honest, forge, capsys):
    Path("entries").mkdir()
    first = format_of.Submission(**honest[0] | {"name": "first"}, files=dict(honest[1]))
    format_of.write(Path("entries") / "a.npz", first)
    assert "plays the same as the entry 'first'" in forge(lambda head, files: None, capsys)


def test_a_baseline_corrected_by_zeros_is_that_baseline(honest, forge, capsys):
    assert entered("ruckig") == 0
    head = vars(format_of.read(Path("entries") / "ruckig.npz"))

    def zeros(arrays):
        arrays.update({n: 0 * a for n, a in arrays.items() if n.startswith("network/action_net")})

    def forged(own, files):
        own["table"] = head["table"]
        about(files, residual="ruckig", bounds=[0.1])
        reweighed(files, zeros)
        Path("entries", "ruckig.npz").rename(Path("entries", "a.npz"))

    assert "plays every episode as the entry 'ruckig' does, to the bit" in forge(forged, capsys)


def test_a_correction_of_what_is_told_has_no_rank(honest):
    """A folder whose base is told what was drawn was rank 1 of version 1 of this page."""
    head, files = copy.deepcopy(honest[0]), dict(honest[1])
    about(files, residual="informed_ruckig", bounds=[0.01])
    made = format_of.Submission(**head, files=files)
    assert made.informed(TASK)
    assert made.plays == "PPO on informed_ruckig"
    assert not format_of.Submission(**head, files=dict(honest[1])).informed(TASK)


def test_a_suite_may_draw_its_seed_from_what_plays_and_nothing_else(honest, tmp_path):
    text = SMALL.replace("seed = 181", 'seed = "of_submission"')
    (tmp_path / "blind.toml").write_text(text, encoding="utf-8")
    blind = suite.read(str(tmp_path / "blind.toml"))
    assert blind.seed is None
    made = format_of.Submission(**honest[0], files=dict(honest[1]))
    drawn = blind.drawn(made.identity).seed
    assert 0 <= drawn <= 1_000_000
    head = honest[0] | {"name": "other", "command": "servogym benchmark learned", "table": {}}
    assert blind.drawn(format_of.Submission(**head, files=made.files).identity).seed == drawn
    files = dict(made.files)
    about(files, steps=1)
    other = format_of.Submission(**honest[0], files=files).identity
    assert blind.drawn(other).seed != drawn
    assert suite.read("v1").drawn(other).seed == 180
