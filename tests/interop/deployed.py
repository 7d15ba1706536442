"""Tasks deployed over a real bus to a server in another process, in a network of their own."""

import contextlib
import itertools
import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

CAN = {"interface": "udp_multicast", "channel": "239.74.163.9"}
TASKS = {
    "linear": "servogym/LinearAxis-v0", "tracking": "servogym/LinearAxisTracking-v0",
    "contour": "servogym/GantryContour-v0", "homing": "servogym/Homing-v0",
}
BUSES = ("can", "ethercat")
REFERENCES = {"linear": "ruckig", "tracking": "feed_forward", "contour": "full_feed",
              "homing": "search"}
FAST, LOW, HIGH = 0.6, 0.05, 0.45  # envelope of the hostile policies: m/s, m
QUIET = 5e-3  # m/s
EPISODES = 12  # at most: one that creeps reaches an end from some of their starts
STARTS = 3  # of a hostile policy, where the machine has other things to do


def _network():
    commands = (
        "link set lo up", "route add 224.0.0.0/4 dev lo", "link add va type veth peer name vb",
        "link set va up", "link set vb up",
    )
    for command in commands:
        subprocess.run(["ip", *command.split()], check=False, capture_output=True)


def _rows(task, bus, clock):
    kinds = {
        "can": {"kind": "can", **CAN, "clock": clock or "sync_end"},
        "ethercat": {"kind": "ethercat", "interface": "va", "clock": clock or "frame"},
    }
    machine = {"bus": "bus", "task": task} | ({"node_id": 1} if bus == "can" else {})
    return {"bus": {"bus": kinds[bus]}, "machine": {"axis": machine}}


def _serve(pipe, rows, task, bus):
    """The process of the machine: does what is asked for between two frames."""
    from servogym.drive.model.model import load
    from servogym.envs.environment.registry import task as named
    from servogym.envs.serve.laboratory import Laboratory

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    laboratory, kept = Laboratory(rows), b""
    with laboratory:
        pipe.send("ready")
        while (order := pipe.recv()) is not None:
            what, *given = order
            said = None
            if what == "stand":
                env = named(task)(load("generic", bus), randomise={})
                env.reset(seed=given[0])
                kept = env.machine.snapshot()
                laboratory.restore("axis", kept)
            elif what == "keep":  # its communication parameters as well
                kept = laboratory.snapshot("axis")
            elif what == "back":
                laboratory.restore("axis", kept)
            elif what == "ahead":
                laboratory.advance(given[0])
            elif what == "reset":
                laboratory.reset("axis")
            elif what == "inject":
                laboratory.inject(next(iter(laboratory.drives)), given[0])
            elif what == "mode":
                said = next(iter(laboratory.drives.values())).mode.name
            elif what == "look":
                said = [
                    (laboratory.state(name), laboratory.position(name), laboratory.velocity(name))
                    for name in laboratory.drives
                ]
            laboratory.check()
            pipe.send(said)


def served(task, bus, clock=""):
    """The machine of a task in another process -> a function that asks it for something."""
    return machine_served(_rows(task, bus, clock), task, bus)


@contextlib.contextmanager
def machine_served(rows, task="", bus=""):
    """A machine file in another process -> a function that asks it for something."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(
        target=_serve, args=(there, rows, task, bus)
    )
    process.start()
    there.close()

    def ask(*order):
        here.send(order)
        return here.recv()

    assert here.recv() == "ready"
    try:
        yield ask
    finally:
        with contextlib.suppress(OSError):
            here.send(None)
        process.join(5.0)
        process.kill()


@contextlib.contextmanager
def side_on(bus, axes, lock_step=True, **arguments):
    """The drives as a master reaches them."""
    import can

    from servogym.drive.wire.bus import CanPort
    from servogym.drive.wire.soem import TIMEOUT, SoemMaster
    from servogym.envs.exchange.over_port import CanDrives, EtherCatDrives, LockStep, Pace

    arguments["pace"] = LockStep() if lock_step else Pace()
    if bus == "ethercat":
        master = SoemMaster("vb", timeout=10.0 if lock_step else TIMEOUT)
        try:
            yield EtherCatDrives(master, axes, "generic", **arguments)
        finally:
            master.close()
        return
    with can.Bus(fd=False, **CAN) as opened:
        nodes = {name: n for n, name in enumerate(axes, 1)}
        yield CanDrives(CanPort(opened), nodes, "generic", **arguments)


def _made(task, bus):
    from servogym.drive.model.model import load
    from servogym.envs.environment.registry import task as named

    kind, model = named(task), load("generic", bus)
    plain = kind(model, randomise={})
    return kind, model, plain, plain.drive_names


def byte_equal(task, bus, policy="", seeds=(5,), steps=60):
    """Steps after which observations are those of memory byte by byte, and metrics of both.

    The served machine is put where that in memory begins each episode. Without a policy, actions
    are small and random.
    """
    from servogym.envs.environment.deployed import Figures
    from servogym.envs.exchange.envelope import Envelope
    from servogym.training.policies import make

    _network()
    task = TASKS[task]
    kind, model, plain, axes = _made(task, bus)
    wide = dict.fromkeys(axes, Envelope(-20.0, 20.0, 100.0))
    told = {"begins": 0, "equal": 0, "steps": 0, "lost": 0, "deployed": [], "memory": []}
    with served(task, bus) as ask:
        for seed in seeds:
            ask("stand", seed)
            with side_on(bus, axes, envelopes=wide) as side:
                env = kind(model, port=side, randomise={})
                place, look = env.line.place, env.line.look
                if bus == "can":
                    ask("keep")

                def placed(*arguments, place=place):
                    here = place(*arguments)
                    ask("back")  # the way there has taken time
                    return here

                def looked(*arguments, look=look):
                    look(*arguments)  # a frame lets time pass
                    ask("back")

                env.line.place, env.line.look = placed, looked
                seen, _ = env.reset(seed=seed)
                expected, info = plain.reset(seed=seed)
                told["begins"] += seen.tobytes() == expected.tobytes()
                plain.action_space.seed(2)
                acting, ended = make(policy or "hold", plain, seed), False
                acting.reset(expected, info)
                there, here = Figures(env), Figures(plain)
                for _ in range(min(steps, plain.STEPS)):
                    action = acting.act(seen) if policy else 0.2 * plain.action_space.sample()
                    seen, reward, ended, _, info = env.step(action)
                    there.step(reward, info)
                    expected, reward, ended, _, info = plain.step(action)
                    here.step(reward, info)
                    told["steps"] += 1
                    told["equal"] += seen.tobytes() == expected.tobytes()
                    if ended:
                        break
                told["deployed"].append(there.values())
                told["memory"].append(here.values())
                told["lost"] += env.line.lost
                env.close()
        told["states"] = [state for state, *_ in ask("look")]
    return told


def watched(env):
    """-> list of what each reset and each step told: observations and rewards, as bytes."""
    told, reset, step = [], env.reset, env.step

    def resetting(**arguments):
        seen, info = reset(**arguments)
        told.append([seen.tobytes()])
        return seen, info

    def stepping(action):
        seen, reward, *others = step(action)
        told[-1].append(seen.tobytes() + np.float64(reward).tobytes())
        return seen, reward, *others

    env.reset, env.step = resetting, stepping
    return told


def episodes(task, bus, policy, count, lock_step=True, seed=0, fast=False, home=17):
    """Metrics of episodes on the bus, of the same in this process, and steps that are equal."""
    from functools import partial

    from servogym.envs.environment.deployed import episodes_of, in_memory
    from servogym.envs.exchange.envelope import Stopped
    from servogym.envs.serve.in_process import environment
    from servogym.training.cli.deploy import made_policy

    _network()
    task = TASKS[task]
    kind, model, plain, axes = _made(task, bus)
    home = home if kind.REFERENCED else None
    clock = "" if lock_step else {"can": "real", "ethercat": "frame"}[bus]
    deployed, stopped, times = [], "", {}
    with served(task, bus, clock), side_on(bus, axes, lock_step) as side:
        env = kind(model, port=side, randomise={})
        env.line.home, there = home, watched(env)
        make = partial(made_policy, policy, plain, seed)
        try:
            for played in episodes_of(env, episodes=count, make=make, seed=seed, fast=fast):
                deployed.append(played.values | {"late": played.late})
        except Stopped as error:
            stopped = f"{error}"
        times = env.line.timing.as_dict()
        env.close()
    played = environment(task, bus, parameters={"randomise": {}}, home=home)
    here = watched(played)
    memory, _ = in_memory(played, made_policy(policy, plain, seed), len(deployed), seed)
    played.close()
    pairs = list(zip(itertools.chain(*here), itertools.chain(*there), strict=False))
    equal = sum(one == other for one, other in pairs)
    return {
        "deployed": deployed, "memory": memory, "stopped": stopped, "times": times,
        "steps": sum(map(len, there)), "equal": equal,
    }


def bring_up(bus, clock, seed=3, pause=0.0):
    """Homed and at its start in real time: the state and place there, and after the end.

    With a pause (s) this process is held up between the homing and the way to the start.
    """
    from servogym.drive.kernel.words import Mode
    from servogym.envs.exchange.envelope import Stopped

    _network()
    task = TASKS["linear"]
    kind, model, _, axes = _made(task, bus)
    with served(task, bus, clock) as ask, side_on(bus, axes, lock_step=False) as side:
        env = kind(model, port=side, randomise={})
        env.line.home, stopped = 17, ""
        set_mode = env.line.master.set_mode

        def held_up(mode):
            time.sleep(pause * (mode == Mode.PROFILE_POSITION))
            set_mode(mode)

        env.line.master.set_mode = held_up
        try:
            env.reset(seed=seed)
        except Stopped as error:
            stopped = f"{error}"
        ((state, position, _),) = ask("look")
        believed = float(env.machine.data.qpos[0])
        env.close()
        ((after, _, _),) = ask("look")
    return {
        "state": state, "position": position, "believed": believed, "after": after,
        "stopped": stopped,
    }


# ----------------------------------------------------------------- hostile


def _at(when, bad):
    return lambda k, space: bad(space) if k == when else np.zeros(space.shape, np.float32)


def _then(when, act):
    def policy(k, space):
        if k >= when:
            act()
        return np.zeros(space.shape, np.float32)

    return policy


def _raise(error):
    raise error


def _hog():
    kept = []
    while True:
        kept.append(np.ones(1 << 24))


def _spin():
    while True:
        pass


def _hold_the_interpreter():
    sum(range(10**12))  # in C, without letting go of it


def _deep():
    return _deep()


def _signal(number):
    return lambda: os.kill(os.getpid(), number)


def _close_all():
    os.closerange(3, 256)
    time.sleep(1.0)


def _threads():
    for _ in range(200):
        threading.Thread(target=time.sleep, args=(5.0,), daemon=True).start()
    time.sleep(5.0)


def _parent():
    os.kill(os.getppid(), signal.SIGINT)  # Ctrl-C of somebody
    time.sleep(1.0)


def _full(share):
    return lambda k, space: share * space.high


def _wave(period, share):
    return lambda k, space: share * space.high * math.copysign(1.0, math.sin(math.tau * k / period))


def _ramp(k, space):
    return min(0.001 * k * k, 1.0) * space.high


def _random(share, seed):
    generator = np.random.default_rng(seed)
    return lambda k, space: share * generator.uniform(-1.0, 1.0, space.shape)


OUT, ENDED, LATE = "out of", "has ended", "late"
HOSTILE = {  # policy, and what is said of it
    **{f"full {share:g}": (_full(share), "velocity") for share in (1.0, 0.5, -1.0, -0.5)},
    **{f"creeps {share:g}": (_full(share), OUT) for share in (0.2, 0.1, -0.2, -0.1)},
    **{f"chatters {n}": (_wave(n, 1.0), "velocity") for n in (2, 3, 4, 8)},
    **{f"chatters a little {n}": (_wave(n, 0.3), "acceleration") for n in (2, 5)},
    **{f"random {seed}": (_random(1.0, seed), "acceleration|velocity") for seed in range(3)},
    "speeds up": (_ramp, "velocity"),
    "steps at 5": (_at(5, lambda space: space.high), "velocity"),
    "steps back at 9": (_at(9, lambda space: space.low), "velocity"),
    **{
        f"{name} at 4": (_at(4, bad), said)
        for name, bad, said in (
            ("NaN", lambda space: np.full(space.shape, np.nan), "nan"),
            ("infinite", lambda space: np.full(space.shape, np.inf), "inf"),
            ("minus infinite", lambda space: np.full(space.shape, -np.inf), "inf"),
            ("too long", lambda space: np.zeros(7), "not in Box"),
            ("empty", lambda space: np.zeros(0), "not in Box"),
            ("two rows", lambda space: np.zeros((2, 1)), "not in Box"),
            ("a number", lambda space: 0.5, "not in Box"),
            ("words", lambda space: ["fast"], "is no number"),
            ("a mapping", lambda space: {"velocity": 1.0}, "is no number"),
            ("nothing", lambda space: None, "is no number"),
            ("an object", lambda space: object(), "is no number"),
            ("beyond 1", lambda space: 1.5 * space.high, "not in Box"),
            ("far beyond", lambda space: 1e30 * space.high, "not in Box"),
            ("complex", lambda space: np.array([1j]), "is no number"),
        )
    },
    **{
        f"raises {error.__name__}": (_then(4, lambda e=error: _raise(e("of its own"))), said)
        for error, said in (
            (ValueError, "of its own"), (SystemExit, "of its own"), (MemoryError, "of its own"),
            (KeyboardInterrupt, "of its own"), (GeneratorExit, "of its own"),
            (StopIteration, "of its own"),
        )
    },
    "never ends its recursion": (_then(4, _deep), "RecursionError"),
    # three whose end depends on the machine: what is not refused within 0.3 s is late before
    "fills the memory": (_then(4, _hog), "MemoryError|has ended|late"),
    "spins": (_then(4, _spin), LATE),
    "holds the interpreter": (_then(4, _hold_the_interpreter), LATE),
    "sleeps": (_then(5, lambda: time.sleep(0.4)), LATE),
    "never answers": (_then(4, lambda: threading.Event().wait()), LATE),
    "starts threads": (_then(4, _threads), "late|RuntimeError"),
    "leaves by exit": (_then(4, lambda: sys.exit(3)), "SystemExit"),
    "leaves at once": (_then(4, lambda: os._exit(3)), "exit status 3"),
    "aborts": (_then(4, os.abort), "SIGABRT"),
    "kills itself": (_then(4, _signal(signal.SIGKILL)), "SIGKILL"),
    "terminates itself": (_then(4, _signal(signal.SIGTERM)), "SIGTERM"),
    "faults": (_then(4, _signal(signal.SIGSEGV)), "SIGSEGV"),
    "closes all files": (_then(4, _close_all), f"{ENDED}|{LATE}"),
    "interrupts its parent": (_then(4, _parent), "Ctrl-C"),
}


def hostile(bus, names):
    """What became of the drive, by policy: the reason, and how far beyond the positions it stands.

    Also the distance in which the guard promises to stop it: four steps, and the quick stop.
    """
    from servogym.envs.environment.deployed import play
    from servogym.envs.exchange.envelope import Envelope, Stopped

    _network()
    task = TASKS["linear"]
    kind, model, plain, axes = _made(task, bus)
    stop = plain.drive.read("quick_stop_deceleration") * 1e-6
    stopping = FAST * plain.step_time * 4 + FAST**2 / 2 / stop
    told = {}
    with served(task, bus) as ask:
        waiting = [*(names or HOSTILE)] * STARTS
        for name in waiting:
            policy, said = HOSTILE[name]
            reason = told[name][0] if name in told else "on the way to the start"
            # again where SOEM has given an SDO up, or where a policy had no time to come to its end
            if not (reason.startswith("on the way") or ("late" in reason and "late" not in said)):
                continue
            ask("stand", 5)
            most = 200.0 if name.startswith("creeps") else 30.0
            limits = {"x": Envelope(LOW, HIGH, FAST, most, following_error=0.02)}
            with side_on(bus, axes, envelopes=limits) as side:
                env = kind(model, port=side, randomise={})
                steps = itertools.count()
                reason = ""
                try:
                    space = env.action_space
                    play(
                        env, lambda seen, policy=policy, steps=steps, space=space:
                        policy(next(steps), space), EPISODES, patience=0.1, seed=5, memory=1 << 29,
                    )
                except Stopped as stopped:
                    reason = f"{stopped}"
                env.close()
            ask("ahead", 0.2)
            ((state, position, velocity),) = ask("look")
            beyond = max(LOW - position, position - HIGH, 0.0)
            told[name] = (reason, state, float(beyond), abs(velocity) < QUIET)
    return {"told": told, "stopping": stopping}


# -------------------------------------------------------------- nobody there


INT, TERM, HUP, KILL = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL
ENDINGS = {  # of the deploying process: when, and the signals it gets one after the other
    "in the first second": ("numpy", (INT,)), "while it loads": ("mujoco", (INT,)),
    "terminated while it loads": ("mujoco", (TERM,)),
    "on the way to a start": ("moving", (INT,)), "twice": ("moving", (INT, INT)),
    "terminated": ("moving", (TERM,)), "three kinds": ("moving", (INT, TERM, INT)),
    "in an episode": ("playing", (INT,)), "twice in an episode": ("playing", (INT, INT)),
    "terminated in an episode": ("playing", (TERM,)),
    "the terminal is closed": ("playing", (HUP,)), "killed": ("moving", (KILL,)),
    "killed in an episode": ("playing", (KILL,)),
}
MOMENTS = ("numpy", "mujoco")  # libraries that it is loading
WAYS = ("HOMING", "PROFILE_POSITION")  # modes on the way to a start


def ended(bus, names):
    """The drive after signals to the process that commands it, and what that has said, by name."""
    _network()
    where = (
        ["--ethercat", "vb"] if bus == "ethercat"
        else ["-i", CAN["interface"], "-c", CAN["channel"]]
    )
    command = [
        sys.executable, "-m", "servogym.training.cli", "deploy", "LinearAxis-v0", "--yes",
        "--policy", "trapezoid", "--episodes", "50", "--home", "17", "--time-limit", "60", *where,
    ]
    told = {}
    with served(TASKS["linear"], bus, "real") as ask:
        for name in names or ENDINGS:
            moment, signals = ENDINGS[name]
            for _ in range(3):  # a busy computer may end it by itself before that moment
                ask("reset")
                process = subprocess.Popen(
                    command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
                before = _at_the_moment(moment, process, ask)
                if process.poll() is None:
                    break
                print(f"{name}: ended by itself: {process.communicate()[0].decode()[-500:]}")
            for number in signals:
                process.send_signal(number)
                time.sleep(0.05)
            said, _ = process.communicate(timeout=60)
            time.sleep(0.4)  # its watchdog, and the stop that follows
            ((after, _, velocity),) = ask("look")
            told[name] = {
                "before": before, "after": after, "stands": abs(velocity) < QUIET,
                "status": process.returncode, "said": said.decode()[-1500:],
            }
    return told


def without_rights():
    """What a master, its log and a server say where nobody may open a raw socket."""
    _network()
    deploy, log = "deploy LinearAxis-v0 --yes --ethercat vb", Path(tempfile.mkdtemp(), "run.pcapng")
    told = {}
    for words in (deploy, f"{deploy} --log {log}", "serve LinearAxis-v0 --ethercat va"):
        command = ["setpriv", "--bounding-set=-net_raw", sys.executable, "-m",
                   "servogym.training.cli", *words.split()]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        told[words] = [done.returncode, done.stderr]
    return told


def _at_the_moment(moment, process, ask):
    """Wait for it; -> state of the drive."""
    until, state = time.monotonic() + 60.0, ""
    if moment in MOMENTS:
        maps = Path(f"/proc/{process.pid}/maps")
        while time.monotonic() < until and moment not in maps.read_text():
            time.sleep(1e-3)
        return ask("look")[0][0]
    while time.monotonic() < until and process.poll() is None:
        ((state, _, velocity),) = ask("look")
        mode = ask("mode")
        moves = state == "OPERATION_ENABLED" and abs(velocity) > 0.05
        if moves and (mode not in WAYS) == (moment == "playing"):
            break
        time.sleep(2e-3)
    return state


if __name__ == "__main__":  # for many episodes: a scenario and its arguments as JSON
    from servogym.envs.plants.catalogue import ethercat_line

    ethercat_line(["generic"], "linear")
    print(json.dumps(globals()[sys.argv[1]](**json.loads(sys.argv[2]))))


def twin_of_log(policy="ruckig", count=3):
    """What the command makes of a deployment's log: statuses, true values, intervals."""
    from servogym.envs.engine import parameters
    from servogym.envs.plants import twins
    from servogym.training.cli import main

    _network()
    folder, names = Path(tempfile.mkdtemp()), ("payload", "coulomb_friction", "viscous_friction")
    log = folder / "run.log"
    with served(TASKS["linear"], "can"):
        words = f"--home 17 --episodes {count} --lock-step --yes -i {CAN['interface']}"
        status = main(["deploy", "LinearAxis-v0", "--policy", policy, *words.split(),
                       "-c", CAN["channel"], "--log", str(log)])
    machine = _made(TASKS["linear"], "can")[2].machine
    out = folder / "twin"
    code = main(["twin", str(log), "--mechanics", "rigid", "-o", str(out)])
    rows = twins.read(out).parameters
    found = {name: (rows[name].low, rows[name].high) for name in names}
    return {"status": [status, code], "true": parameters.get(machine, names), "found": found}
