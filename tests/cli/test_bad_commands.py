"""Wrong commands: each is refused in a line of words, with status 2."""

import re
from pathlib import Path

import pytest

from servogym.training import cli

RAW = re.compile(
    r"Traceback|\[Errno|Error\b.*Error\b|KeyError|IndexError|AttributeError|__init__|NoneType|"
    r"object has no|unexpected keyword|positional argument|<class|<function|not supported between|"
    r"could not convert|invalid literal|codec can't|Expecting value"
)
# one a line; words are separated by spaces
COMMANDS = """
nothing
compar LinearAxis-v0 --policies hold
Demo
demo --drive nothing
demo --drive gneric
demo --drive .
demo --drive /dev/null
demo --drive FILE
demo --payload heavy
demo --payload nan
demo --payload -1
demo --payload 1e9
demo --payload inf
demo --out FILE
demo --out FILE/below
demo --colour red
demo extra
demo --drive
bench --repeat 0
bench --repeat -3
bench --repeat many
bench --drive nothing
bench --envs --drive nothing
bench --workers 0
bench --workers -1
bench --out there
drives nothing
drives FILE
drives .
drives generic kollmorgen_akd
drives --json
node --axis nothing --drive generic
node --drive nothing
node --node-id 0
node --node-id 128
node --node-id one
node --node-id 1 --node-id 1
node -i nothing
node -i socketcan -c nothing0
node -b fast
node -b 0 -i virtual
node -b -1 -i virtual
node --log FILE/run.log -i virtual
node --log . -i virtual
node --drive kollmorgen_akd -i virtual
node --bus-config nothing
node --drive generic --parameter-file . -i virtual
ethercat
ethercat -i nothing0
ethercat -i a -i b -i c
ethercat --udp 127.0.0.2 -i veth1
ethercat --udp 999.1.1.1
ethercat --udp 127.0.0.2 --clock sundial
ethercat --udp 127.0.0.2 --slaves 0
ethercat --udp 127.0.0.2 --slaves two
ethercat --udp 127.0.0.2 --seed -1
ethercat --udp 127.0.0.2 --fault nonsense
serve LinearAxis-v0 --seed -1 -i virtual
serve LinearAxis-v0 --node-id 0 -i virtual
ethercat --udp 127.0.0.2 --fault drop at=never
ethercat --udp 127.0.0.2 --drive nothing
ethercat --udp 127.0.0.2 --drive festo_cmms
ethercat --udp 127.0.0.2 --log run.txt
ethercat --udp 127.0.0.2 --log FILE/run.pcapng
ethercat --udp 127.0.0.2 --axis nothing
eds
eds generic
eds nothing -o new.eds
eds generic -o FILE/new.eds
eds generic -o .
eds generic -o new.txt
eds generic -o new.eds --dcf
eds generic -o new.dcf --dcf --node-id 0
eds generic -o new.dcf --dcf --node-id 200
eds generic -o new.eds --node-id 5
eds kollmorgen_akd -o new.eds --dcf --node-id x
esi
esi nothing -o new.xml
esi festo_cmms -o new.xml
esi kollmorgen_akd -o FILE/new.xml
esi kollmorgen_akd -o .
decode
decode nothing.log
decode FILE
decode .
decode EMPTY.log
decode EMPTY.pcapng
decode NOISE.log
decode NOISE.pcapng
decode NOISE.asc
decode NOISE.blf
decode NOISE.trc
decode NOISE.csv
decode EMPTY.log --drive nothing
decode EMPTY.log --node-id 0
decode EMPTY.log --node-id 300
decode EMPTY.pcapng --node-id 1
homing
homing --gallery FILE
homing --gallery FILE/below
homing --gallery new --method 99
homing --gallery new --method first
homing --gallery new --format pdf
watch
watch nothing
watch LinearAxs-v0
watch nothing:Nudge-v0
watch CartPole-v1
watch LinearAxis-v0 --policy nothing
watch LinearAxis-v0 --policy rukig --record new.gif
watch LinearAxis-v0 --policy lqr --record new.gif
watch LinearAxis-v0 --policy built_in --record new.gif
watch LinearAxis-v0 --policy nothing.py:act --record new.gif
watch LinearAxis-v0 --policy FILE.py:act --record new.gif
watch LinearAxis-v0 --policy broken.py:act --record new.gif
watch LinearAxis-v0 --policy wrong.py:act --record new.gif
watch LinearAxis-v0 --policy wrong.py:Class --record new.gif
eval LinearAxis-v0 --policy wrong.py:text --episodes 1
eval LinearAxis-v0 --policy wrong.py:nothing --episodes 1
eval LinearAxis-v0 --policy wrong.py:nan --episodes 1
watch LinearAxis-v0 --policy wrong.py --record new.gif
watch LinearAxis-v0 --policy wrong.py:number --record new.gif
watch LinearAxis-v0 --policy wrong.py:missing --record new.gif
watch LinearAxis-v0 --episodes 0 --record new.gif
watch LinearAxis-v0 --seed -1 --record new.gif
watch LinearAxis-v0 --speed 0 --record new.gif
watch LinearAxis-v0 --speed nan --record new.gif
watch LinearAxis-v0 --record new.avi
watch LinearAxis-v0 --record FILE
watch LinearAxis-v0 --record FILE/new.gif
watch LinearAxis-v0 --drive festo_cmms --record new.gif
watch LinearAxis-v0 --argument payload --record new.gif
watch LinearAxis-v0 --argument payload=heavy --record new.gif
watch LinearAxis-v0 --argument paylod=3 --record new.gif
watch LinearAxis-v0 --argument parameters={} --record new.gif
watch LinearAxis-v0 --argument randomise=[1,2] --record new.gif
watch LinearAxis-v0 --argument randomise={"mass":1} --record new.gif
eval LinearAxis-v0 --policy hold --argument faults=["drp"]
watch LinearAxis-v0 --argument history=none --record new.gif
watch LinearAxis-v0 --argument step_time=fast --record new.gif
watch LinearAxis-v0 --argument drive=generic --record new.gif
watch LinearAxis-v0 --argument mode=pp --record new.gif
watch LinearAxis-v0 --argument mode=[1] --record new.gif
watch GantryContour-v0 --argument contour=star --record new.gif
eval
eval LinearAxis-v0
eval LinearAxis-v0 --policy nothing
eval LinearAxis-v0 --policy hold --episodes 0
eval LinearAxis-v0 --policy hold --episodes 100000
eval LinearAxis-v0 --policy hold --seed -1
eval LinearAxis-v0 --policy hold --trace 50
eval LinearAxis-v0 --policy hold --out FILE
eval LinearAxis-v0 --policy .
eval LinearAxis-v0 --policy built_in:x
eval Homing-v0 --policy built_in:99 --episodes 1
eval LinearAxis-v0 --policy wrong.py:shape --episodes 1
eval LinearAxis-v0 --policy wrong.py:Raises --episodes 1
compare LinearAxis-v0
compare LinearAxis-v0 --policies ,
compare LinearAxis-v0 --policies hold,nothing
compare LinearAxis-v0 --policies hold --conditions nothing
compare LinearAxis-v0 --policies hold --argument =3
compare LinearAxis-v0 --policies hold --argument a-b=
compare LinearAxis-v0 --polices hold
compare LinearAxis-v0 --policies learned --drive nothing
compare Homing-v0 --policies learned,lqr
train
train nothing
train LinearAxis-v0 --setting gamma=2
train LinearAxis-v0 --setting batch_size=1
train LinearAxis-v0 --setting n_epochs=0
train LinearAxis-v0 --setting n_envs=true
train LinearAxis-v0 --setting n_envs=2.5
train LinearAxis-v0 --setting n_envs=1 --setting n_steps=1
train LinearAxis-v0 --setting normalize=maybe
train LinearAxis-v0 --setting clip_range=x
train LinearAxis-v0 --setting ent_coef=x
train LinearAxis-v0 --setting target_kl=x
train LinearAxis-v0 --setting learning_rate=-1
train LinearAxis-v0 --setting seed=3
train LinearAxis-v0 --setting device=mars
train LinearAxis-v0 --setting policy_kwargs=7
train LinearAxis-v0 --setting policy_kwargs={"net_arch":"x"}
train LinearAxis-v0 --setting policy_kwargs={"net_arch":[-1]}
train LinearAxis-v0 --algorithm sac --setting train_freq=0
train LinearAxis-v0 --algorithm sac --setting ent_coef=foo
train LinearAxis-v0 --argument drive=generic
watch LinearAxis-v0 --argument drive=generic --record x.gif
watch LinearAxis-v0 --policy wrong.py --record x.gif
watch LinearAxis-v0 --policy wrong.py:waits --record x.gif
watch LinearAxis-v0 --policy wrong.py:yields --record x.gif
watch LinearAxis-v0 --policy= --record x.gif
watch LinearAxis-v0 --record=
watch Robot-v0 --argument mjcf=nan.xml --record x.gif
watch Robot-v0 --argument mjcf=FILE --record x.gif
compare LinearAxis-v0 --policies hold --conditions=
compare LinearAxis-v0 --policies hold --ray 300.300.300.300:1
results --train FILE
demo --out=
node -i serial
train LinearAxis-v0 --algorithm DQN
train LinearAxis-v0 --steps 0
train LinearAxis-v0 --steps 1e6
train LinearAxis-v0 --envs 0
train LinearAxis-v0 --seed -1
train LinearAxis-v0 --resume --out new
train LinearAxis-v0 --out FILE
train LinearAxis-v0 --bounds 0.1
train LinearAxis-v0 --bounds small
train LinearAxis-v0 --residual ruckig
train LinearAxis-v0 --residual nothing --bounds 0.1
train LinearAxis-v0 --checkpoint-every 0
train LinearAxis-v0 --argument paylod=3
train LinearAxis-v0 --drive nothing
curves
curves nothing
curves FILE
curves .
results nothing
results FILE
results .
benchmark
benchmark everything
benchmark homing --drive nothing
benchmark homing --drive bonfiglioli_act
benchmark positioning --out FILE
benchmark positioning --payload ,
benchmark positioning --distance ,
benchmark homing --mechanics ,,
machines --set payload=nan
machines --set nothing=1
machines rotary_table --set payload=1
machines gantry --set gear_ratio=1
machines rigid --set tuned=perhaps
machines rigid --set drive=generic
machines rigid --set parameters=3
machines gantry-x1x2 --set x_drives=1
machines nothing
tune --move 0
tune --move nan
tune --amplitude 0
tune --amplitude nan
tune-policy tuned_ruckig --task LinearAxis-v0 --budget 0
tune-policy tuned_ruckig --task LinearAxis-v0 --budget -1
tune --seed -1
bode --seed -1
tune --out FILE
tune --gear 3
tune robot.xml
tune broken.xml --axis elbow
tune broken.xml
bode --speed 100
bode --out FILE
scope rigid --rate nan
scope rigid --duration -1
scope --channels ,
scope --before 5000 --depth 100
scope --out FILE
scope bus -i virtual --duration 0
sweep LinearAxis-v0 --policies hold --drives generic,nothing
train LinearAxis-v0 --setting learning_rat=1e-3
watch Robot-v0 --argument mjcf=broken.xml --record new.gif
watch Robot-v0 --argument mjcf=robot.xml --argument goals=elbo --record new.gif
eval LinearAxis-v0 --policy wrong.py:two --episodes 1
eval LinearAxis-v0 --policy wrong.py:exits --episodes 1
drives --from-eds . -o new
""".strip().splitlines()

WRONG = """
import numpy as np
number = 3
def shape(observation): return np.zeros(7)
def text(observation): return "left"
def nothing(observation): return None
def nan(observation): return np.array([np.nan])
def two(observation, gain): return np.zeros(1)
def exits(observation): raise SystemExit(0)
class Class:
    def act(self, observation): return np.zeros(1)
class Raises:
    def __init__(self, datasheet, seed): pass
    def reset(self, observation, info): pass
    def act(self, observation): return {}["speed"]

async def waits(observation):
    return [0.0]

def yields(observation):
    yield 0.0
"""


ROBOT = """<mujoco><worldbody><body><joint name="elbow" type="hinge"/><geom size="0.1"/></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wrong")
    (folder / "FILE").write_text("not what was meant\n")
    (folder / "FILE.py").write_text("")
    (folder / "broken.py").write_text("def act(:\n")
    (folder / "broken.xml").write_text("<mujoco><worldbody>")
    (folder / "robot.xml").write_text(ROBOT)
    (folder / "nan.xml").write_text(ROBOT.replace('type="hinge"', 'range="0 nan"'))
    (folder / "wrong.py").write_text(WRONG)
    for suffix in ("log", "pcapng"):
        (folder / f"EMPTY.{suffix}").touch()
    for suffix in ("log", "pcapng", "asc", "blf", "trc", "csv"):
        (folder / f"NOISE.{suffix}").write_bytes(bytes(range(256)) * 4)
    return folder


def told(capsys, words):
    """Status and what stands on stderr, of a command in this process."""
    try:
        status = cli.main(words)
    except SystemExit as exit_info:
        status = exit_info.code
    return status, capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # python-can, of a .blf that is none
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("line", COMMANDS)
def test_a_wrong_command_is_refused_in_words(line, place, capsys, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    before = sorted(Path().rglob("*"))
    words = (
        line.split(" ")
        if "--fault" not in line
        else [*line.partition(" --fault ")[0].split(), "--fault", line.partition(" --fault ")[2]]
    )
    status, error = told(capsys, words)
    assert status == 2, error
    last = error.rstrip().rpartition("\n")[2]
    assert last.startswith("servogym"), error
    assert len(last) < 700, error
    if "wrong.py, line" not in error:  # what the user's own code raised is told as it is
        assert not RAW.search(error), error
    made = {path for path in set(Path().rglob("*")) - set(before) if "__pycache__" not in str(path)}
    assert not [path for path in made if path.is_file() and path.name != ".lock"], made


def test_there_are_more_than_115():
    assert len(set(COMMANDS)) == len(COMMANDS) >= 115
