"""Ownership of memory: nothing a program does to machines and environments crashes the interpreter.

Each group of cases runs in a process of its own, which a segmentation fault would end: a copy of
one that has loaded all of it. A case says in words what has to come of it: nothing, or the
exception.
"""

import json
import os
import subprocess
import sys

import pytest

BEGIN = """
import copy, faulthandler, gc, os, pickle, signal, sys, threading, time, warnings
import mujoco
import numpy as np
faulthandler.enable()
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever started us
from servogym.drive.drive import Drive
from servogym.drive.kernel import record
from servogym.envs import Machine, linear_axis, gantry
from servogym.envs.engine.residence import Residence
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.sway import GantrySwayEnv
from servogym.envs.environment.vector_env import ServoVectorEnv

def refused(error, words, call, *arguments, **named):
    try:
        call(*arguments, **named)
    except error as found:
        assert words in str(found), (words, str(found))
    else:
        raise AssertionError(f"{error} was expected")

def vector(n=3, threads=1, **arguments):
    made = ServoVectorEnv(LinearAxisEnv, n, threads=threads, **arguments)
    made.reset(seed=1)
    return made

def act(env, k=0):
    return np.full(env.action_space.shape, 0.1 * (k % 7) - 0.3)

def same(one, other, steps=5):
    for k in range(steps):
        a, b = one.step(act(one, k)), other.step(act(other, k))
        assert np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1])

def forbidden(model, data):
    raise KeyError("mine")

def with_callback(callback, call):
    mujoco.set_mjcb_control(callback)
    try:
        call()
    finally:
        mujoco.set_mjcb_control(None)

PILE = "".join(
    f"<body pos='{3 * i} 0 9'><freejoint/><geom type='box' size='.1 .1 .1'/></body>"
    for i in range(20)
)
def crowded():
    "A machine whose arena is too small once its boxes lie in a heap."
    return Machine(mujoco.MjModel.from_xml_string(
        f"<mujoco><option timestep='62.5e-6'/><size memory='60K'/><worldbody>"
        f"<geom type='plane' size='1 1 1'/>{PILE}<body><joint name='x' type='slide'/>"
        "<geom size='.1'/></body></worldbody>"
        "<actuator><motor name='x' joint='x' gear='100'/></actuator></mujoco>"), {"x": "generic"})
def heap(machine):
    machine.data.qpos[:140].reshape(20, 7)[:, :3] = np.c_[
        np.zeros(20), np.zeros(20), np.arange(20) * 0.05]
"""

# name of the fact, and what proves it; groups of one interpreter each
GROUPS = {
    "copies": """
# a vector is deep-copied before its first step, and the copy goes on alone
v = vector(); w = copy.deepcopy(v); same(v, w)
# in mid-episode
v = vector(); v.step(act(v)); w = copy.deepcopy(v); same(v, w)
# with threads that have run
v = vector(4, 2); v.step(act(v)); w = copy.deepcopy(v); same(v, w)
# pickled before its first reset
v = ServoVectorEnv(LinearAxisEnv, 2, threads=1); w = pickle.loads(pickle.dumps(v))
v.reset(seed=4); w.reset(seed=4); same(v, w)
# a copy outlives its original
w = copy.deepcopy(vector()); gc.collect(); w.step(act(w)); w.step(act(w))
# a copy does not move the original
v = vector(); w = copy.deepcopy(v); before = v.envs[0].machine.snapshot(); w.step(act(w))
assert v.envs[0].machine.snapshot() == before
# a shallow copy is a copy too
v = vector(); w = copy.copy(v); same(v, w)
# with randomisation, history, noise and faults
arguments = dict(randomise={"payload": (0.5, 2), "encoder_noise": 1e-5, "delay": (0, 3)}, history=3,
                 previous_action=True, faults={"encoder_loss": 0.02})
v = vector(3, 2, **arguments); v.step(act(v)); w = pickle.loads(pickle.dumps(v)); same(v, w, 20)
# an environment of a vector, copied, is one of its own
v = vector(); e = copy.deepcopy(v.envs[1]); expected = v.step(act(v))[0][1]
assert np.array_equal(e.step(act(v)[1])[0], expected); del v; gc.collect(); e.step(np.zeros(1))
# a gantry's environment
e = GantrySwayEnv(); e.reset(seed=1); f = copy.deepcopy(e); same(e, f)
# its sampler of actions goes on alike
e = LinearAxisEnv(); e.action_space.seed(3); e.action_space.sample(); f = pickle.loads(pickle.dumps(e))
assert np.array_equal(e.action_space.sample(), f.action_space.sample())
# a machine in motion
m = linear_axis("generic"); m.step(7); n = copy.deepcopy(m); m.step(50); n.step(50)
assert m.snapshot() == n.snapshot()
# a machine of two drives, through a pickle
m = gantry(); m.step(7); n = pickle.loads(pickle.dumps(m)); m.step(50); n.step(50)
assert m.snapshot() == n.snapshot()
# a machine that shares its MjData
v = vector(); n = copy.deepcopy(v.envs[1].machine); m = v.envs[1].machine
m.step(9); n.step(9); assert m.snapshot() == n.snapshot(); del v, m; gc.collect(); n.step(9)
# a reset of a copy is the reset of the original
m = linear_axis("festo_cmmp_as"); n = copy.deepcopy(m); m.reset(); n.reset()
assert m.snapshot() == n.snapshot()
# a drive with stored and commissioned values
d = Drive(); d.write("profile_velocity", 77); d.parameters.save(); d.write("profile_velocity", 5)
d.commission({"set_point_loss_limit": 1}); e = pickle.loads(pickle.dumps(d)); d.reset(); e.reset()
assert e.snapshot() == d.snapshot() and e.read("profile_velocity") == 77
# a drive of a machine
m = linear_axis(); d = copy.deepcopy(m.drives["x"]); m.step(3); del m; gc.collect(); d.cycle(0.0)
""",  # noqa: E501
    "lifetimes": """
# an environment outlives its vector
v = vector(3); e = v.envs[2]; del v; gc.collect()
for k in range(5): e.step(act(e, k))
# each of them, in turn
v = vector(3); kept = list(v.envs); del v; gc.collect()
for k in range(4): [e.step(act(e, k)) for e in kept]
# a machine outlives its environment and its vector
v = vector(3); m = v.envs[1].machine; v.step(act(v)); del v; gc.collect(); m.step(20); m.data.qpos[0]
# who lived in the MjData before is gone
v = vector(3); a, b = v.envs[0].machine, v.envs[1].machine; b.step(); del v, b; gc.collect()
junk = [np.ones(300) for _ in range(1000)]; a.step(5); a.reset(); a.step(5)
# the residence is gone
v = vector(2); m = v.envs[0].machine; r = m._residence; del v, r; gc.collect(); m.step(5)
# a closed vector
v = vector(4, 2); v.step(act(v)); v.close(); e = v.envs[3]; del v; gc.collect(); e.step(np.zeros(1))
# a drive outlives its machine
d = linear_axis().drives["x"]; gc.collect(); d.cycle(0.0); d.read("statusword")
# arrays outlive it
m = linear_axis(); q, axes = m.data.qpos, m.axes; del m; gc.collect(); q[0] += 1; axes[0].torque
# names of a machine are given away
m = linear_axis(); m.axes = m.couplings = m.mechanics = m.world = m.probes = None; gc.collect()
junk = [np.ones(600) for _ in range(1000)]; m.step(20)
# drives are taken away
m = linear_axis(); m.drives.clear(); gc.collect(); m.step(5)
# records of PDOs are given away
m = linear_axis(); d = m.drives["x"]; d.rpdos = d.tpdos = None; gc.collect(); m.step(5)
# a probe is asked for twice
m = linear_axis(); m.probe(); m.probe(); gc.collect(); m.step(20)
# a vector is deleted while its threads are alive
v = vector(4, 4); v.step(act(v)); del v; gc.collect()
# an exception in building leaves nothing behind
refused(ValueError, "num_envs", ServoVectorEnv, LinearAxisEnv, 0); gc.collect()
# machines of another kind do not live together
other = linear_axis()
refused(ValueError, "another machine", gantry().share, Residence(other.model, other.data))
# an image of the observation stays what it was
v = vector(2); o, *_ = v.step(act(v)); c = o.copy(); del_ = v.step(act(v, 3)); assert np.array_equal(o, c)
""",  # noqa: E501
    "errors of MuJoCo": """
# a full arena is a FatalError, and the process lives
m = crowded(); heap(m); refused(mujoco.FatalError, "stack overflow", m.step, 3)
# the machine says so until it is reset
m = crowded(); heap(m); refused(mujoco.FatalError, "reset()", m.step)
refused(RuntimeError, "earlier step failed", m.step); m.reset(); m.step(50); assert m.time > 0
# it has no snapshot then, and takes one
m = crowded(); m.step(3); s = m.snapshot(); heap(m); refused(mujoco.FatalError, "memory", m.step)
refused(RuntimeError, "no snapshot can be taken", m.snapshot); m.restore(s); m.step(); assert m.time > 0
# a hundred times
m = crowded()
for _ in range(100): heap(m); refused(mujoco.FatalError, "memory", m.step); m.reset()
m.step(10)
# what a callback raises arrives
m = linear_axis(); refused(KeyError, "mine", with_callback, forbidden, m.step); m.reset(); m.step(5)
# Ctrl-C in a callback
def interrupted(model, data): raise KeyboardInterrupt
m = linear_axis(); refused(KeyboardInterrupt, "", with_callback, interrupted, m.step)
# a callback that exits
def leaving(model, data): sys.exit(3)
m = linear_axis(); refused(SystemExit, "3", with_callback, leaving, m.step)
# in a vector: it has to be reset, and goes on
v = vector(4); refused(KeyError, "mine", with_callback, forbidden, lambda: v.step(act(v)))
refused(Exception, "reset()", v.step, act(v)); v.reset(seed=2); v.step(act(v))
# on the threads of a vector
v = vector(4, 4); refused(KeyError, "mine", with_callback, forbidden, lambda: v.step(act(v)))
v.reset(seed=2); w = vector(4); w.reset(seed=2); same(v, w)
# in an environment alone
e = LinearAxisEnv(); e.reset(seed=1)
refused(KeyError, "mine", with_callback, forbidden, lambda: e.step(np.zeros(1)))
refused(RuntimeError, "earlier step failed", e.step, np.zeros(1)); e.reset(seed=1); e.step(np.zeros(1))
# its neighbour in the same MjData is unharmed
v = vector(2); a, b = (e.machine for e in v.envs); b.step(3); s = b.snapshot()
refused(KeyError, "mine", with_callback, forbidden, a.step); assert b.snapshot() == s; a.reset(); a.step()
# a callback that steps the machine it is called by
m = linear_axis(); refused(RuntimeError, "callback", with_callback, lambda *_: m.step(), m.step)
# or resets it, or another one
m = linear_axis(); n = linear_axis()
refused(RuntimeError, "callback", with_callback, lambda *_: m.reset(), m.step); m.reset()
refused(RuntimeError, "callback", with_callback, lambda *_: n.step(), m.step); m.reset(); m.step()
# a callback that reads is welcome
seen = []; m = linear_axis(); with_callback(lambda model, data: seen.append(data.time), m.step)
assert len(seen) == m.physics_steps
# on another thread
m = crowded(); heap(m); t = threading.Thread(target=refused, args=(mujoco.FatalError, "memory", m.step))
t.start(); t.join(); m.reset(); m.step()
# an exception of a reset
m = linear_axis(); refused(KeyError, "mine", with_callback, forbidden, m.reset); m.reset(); m.step()
""",  # noqa: E501
    "snapshots": """
# one bit of it altered, anywhere
m = linear_axis(); m.step(5); s = m.snapshot(); g = np.random.default_rng(1); before = s
for _ in range(300):
    t = bytearray(s); t[g.integers(len(t))] ^= 1 << g.integers(8); refused(ValueError, "", m.restore, bytes(t))
assert m.snapshot() == before
# cut off anywhere
for n in range(0, len(s), 97): refused(ValueError, "take a new one", m.restore, s[:n])
# longer than it should be
refused(ValueError, "checksum", m.restore, s + b"x"); refused(ValueError, "", m.restore, s + s)
# of another machine, drive, model
refused(ValueError, "drives", m.restore, gantry().snapshot())
refused(ValueError, "drives", m.restore, linear_axis("festo_cmmp_as").snapshot())
refused(ValueError, "kind", m.restore, Drive().snapshot())
# of a machine with another joint; its gear is a parameter that comes with the snapshot
n = linear_axis(); n.model.jnt_range[0, 1] *= 2; refused(ValueError, "MjModel", m.restore, n.snapshot())
# masses, friction, stiffness and gear come with it
n = linear_axis(payload=3.0); n.step(20); m.restore(n.snapshot()); m.step(20); n.step(20)
assert m.snapshot() == n.snapshot()
# a drive's, altered
d = Drive(); s = d.snapshot()
for _ in range(300):
    t = bytearray(s); t[g.integers(len(t))] ^= 1 << g.integers(8); refused(ValueError, "", d.restore, bytes(t))
# of an older version
refused(ValueError, "version", d.restore, s.replace(b"snapshot 4", b"snapshot 3", 1))
refused(ValueError, "not a snapshot", d.restore, b"1 generic 4728" + bytes(9000))
# of another model
refused(ValueError, "model", d.restore, Drive("kollmorgen_akd").snapshot())
# stored and commissioned values belong to it
d.write("profile_velocity", 7); d.parameters.save(); s = d.snapshot(); d.parameters.forget()
d.reset(); assert d.read("profile_velocity") != 7; d.restore(s); d.reset(); assert d.read("profile_velocity") == 7
# not bytes at all
for wrong in (b"", b"\\n", b"servogym-snapshot", b"servogym-snapshot 3 x\\n{}", bytearray(9), memoryview(b"12")):
    refused(ValueError, "", d.restore, wrong)
""",  # noqa: E501
    "threads": """
# many threads on one machine
def together(*calls, times=1):
    failed = []
    def run(call):
        try:
            for _ in range(times): call()
        except BaseException as error: failed.append(error)
    threads = [threading.Thread(target=run, args=(call,)) for call in calls]
    [t.start() for t in threads]; [t.join() for t in threads]
    assert not failed, failed
m = linear_axis(); together(*[lambda: m.step(20)] * 4, times=50)
assert round(m.time / m.cycle_time) == 4 * 50 * 20
# stepping and resetting
together(lambda: m.step(20), m.reset, m.snapshot, times=50)
# stepping and restoring
s = m.snapshot(); together(lambda: m.step(20), lambda: m.restore(s), times=50)
# stepping and mapping PDOs
d = m.drives["x"]; together(lambda: m.step(20), lambda: d.map_pdos([["controlword"]], [["statusword"]]), times=20)
# reading the data of an environment while its vector steps
v = vector(6, 2); together(lambda: v.step(act(v)), *[
    (lambda i=i: v.envs[i].machine.data.qpos.copy()) for i in range(6)], times=40)
# stepping environments while the vector steps
v = vector(4, 2); together(lambda: v.step(act(v)), *[
    (lambda i=i: v.envs[i].machine.step(2)) for i in range(4)], times=30)
# a vector from two threads
v = vector(4, 2); together(*[lambda: v.step(act(v))] * 3, times=20)
# one environment from three
e = LinearAxisEnv(); e.reset(seed=1); together(*[lambda: e.step(np.zeros(1))] * 3, times=50)
# copies while it steps
v = vector(4, 2); together(lambda: v.step(act(v)), lambda: copy.deepcopy(v), times=10)
# one thread after the other, each with its own batch
for _ in range(50): t = threading.Thread(target=m.step); t.start(); t.join()
# Ctrl-C in a long step: what is computed after the signal is less than 0.2 s of one core
sent = []
def after(delay, *machines):
    main = threading.main_thread().ident
    def send():  # and only then look: this thread may have to wait between the two
        signal.pthread_kill(main, signal.SIGINT)
        sent[:] = [time.process_time(), sum(int(m.world["tick"][0]) for m in machines)]
    timer = threading.Timer(delay, send)
    timer.start()
    return timer
def interrupted(call, *machines, cores=1, delay=0.3):
    timer = after(delay, *machines); refused(KeyboardInterrupt, "", call); timer.join()
    spent = (time.process_time() - sent[0]) / cores
    ticks = sum(int(m.world["tick"][0]) for m in machines) - sent[1]
    pace = max(int(m.world["pace"][0]) for m in machines)
    print(f"{spent * 1e3:.0f} ms, {ticks} physics steps after Ctrl-C, pace {pace}", file=sys.stderr)
    assert spent < 0.2, spent
    assert 0 <= ticks <= cores * 2 * pace, (ticks, pace)
m = linear_axis(); m.step(10); interrupted(lambda: m.step(10**9), m)
assert m.time > 0.1 and round(m.time / m.model.opt.timestep) % m.physics_steps == 0
m.step(5); assert m.snapshot()
# it goes on as if nothing had been
n = linear_axis(); n.step(round(m.time / m.cycle_time)); assert m.snapshot() == n.snapshot()
# in a step of two drives, and of one of them that is slow
m = gantry(); interrupted(lambda: m.step(10**9), m); m.step()
# with a callback in Python
def looking(model, data): data.time
m = linear_axis(); with_callback(looking, lambda: interrupted(lambda: m.step(10**9), m)); m.reset(); m.step()
# in steps of a vector that take most of a second each, with threads and without
def long():
    while True: v.step(act(v))
for threads in (1, 2):
    v = ServoVectorEnv(LinearAxisEnv, 64, threads=threads, step_time=0.5); v.reset(seed=1)
    interrupted(long, *(e.machine for e in v.envs), cores=threads)
v.reset(seed=1); v.step(act(v))
""",  # noqa: E501
    "forks": """
# a vector with threads goes on in a forked process
def child(work):
    pid = os.fork()
    if not pid:
        code = 1
        try: work(); code = 0
        finally: os._exit(code)
    for _ in range(600):
        done, status = os.waitpid(pid, os.WNOHANG)
        if done: break
        time.sleep(0.05)
    else: os.kill(pid, signal.SIGKILL); raise AssertionError("the child hangs")
    assert status == 0, status
warnings.simplefilter("ignore")
v = vector(4, 2); v.step(act(v)); child(lambda: v.step(act(v))); v.step(act(v))
# with the same numbers
w = copy.deepcopy(v); expected = w.step(act(w))[0]
def equal(): assert np.array_equal(v.step(act(v))[0], expected)
child(equal)
# while another thread steps the machine
m = linear_axis(); stop = []
def busy():
    while not stop: m.step(500)
t = threading.Thread(target=busy); t.start(); n = linear_axis(); n.step(5)
child(lambda: n.step(5)); child(lambda: linear_axis().step(5)); stop.append(1); t.join()
# while another thread compiles
import numba
def longish(x):
    for i in range(9): x = x * 1.5 + i if x > i else x - i
    return x
def compiling():
    while not stop:
        chain = numba.njit(longish)
        for _ in range(5): chain = numba.njit(lambda x, f=chain: f(x) + 1.0)
        chain(1.0); begun.set()
stop.clear(); begun = threading.Event(); t = threading.Thread(target=compiling)
t.start(); begun.wait()
for k in range(2): child(lambda: numba.njit(lambda x: x + k)(1)); time.sleep(0.05)
stop.append(1); t.join(); child(lambda: (linear_axis("festo_cmms").step(5), m.step(5)))
# an error of MuJoCo in the child stays there
m = crowded(); m.step()
def fail(): heap(m); refused(mujoco.FatalError, "memory", m.step)
child(fail); m.step(5)
""",
    "bad input": """
# a number of cycles that is none
m = linear_axis()
for wrong in (1.5, -5, "3", None, True, float("nan"), float("inf"), 10**30, [1], np.float64(0.5)):
    refused(ValueError, "cycles", m.step, wrong)
m.step(0); m.step(np.int64(2)); assert round(m.time / m.cycle_time) == 2
# an index in the couplings
for field in ("qpos", "dof", "ctrl"):
    for wrong in (10**12, -1, 2**62):
        m = linear_axis(); m.couplings[field] = wrong; refused(ValueError, "couplings", m.step)
# a period of 0
m = linear_axis(); m.couplings["velocity_steps"] = 0; refused(ValueError, "period", m.step)
# an index in the mechanics
for field in ("guide", "inertia_at"):
    m = linear_axis(); m.mechanics[field] = 10**9; refused(ValueError, "mechanics", m.step)
m = linear_axis(stiffness=2e4)
m.mechanics["elastic_qpos"] = -7; m.mechanics["guide"] = 0; refused(ValueError, "mechanics", m.step)
# an index in a probe
m = linear_axis(); m.probe()["first"] = 10**9; refused(ValueError, "probes", m.step)
m = linear_axis(); m.probe()["jerk_ticks"] = 0; refused(ValueError, "probes", m.step)
# coordinates that are none
for wrong in (np.nan, np.inf, 1e300):
    m = linear_axis(); m.data.qpos[:] = wrong; m.step(20); m.reset(); m.step(5)
# the PDO mapping of an environment's drive
e = LinearAxisEnv(); e.reset(seed=1)
e.drive.map_pdos([["controlword"]], [["statusword", "position_actual_value"]] * 4)
refused(RuntimeError, "PDO mapping", e.step, np.zeros(1))
e = LinearAxisEnv(); e.reset(seed=1); e.drive.map_pdos([], []); refused(RuntimeError, "PDO mapping", e.step, np.zeros(1))
# in a vector
v = vector(2); v.envs[1].drive.map_pdos([], []); refused(RuntimeError, "machine 1", v.step, act(v))
# a record of PDOs filled with noise
m = linear_axis(); d = m.drives["x"]; g = np.random.default_rng(2)
for k in range(30):
    for pdos in (d.rpdos, d.tpdos):
        pdos.view(np.uint8)[:] = g.integers(0, 256, pdos.nbytes)
        pdos["valid"], pdos["width"] = 1, g.integers(-1, 99, len(pdos))
        if k % 2: pdos["length"] = g.integers(-2, 9, pdos["length"].shape)
    d.image_changed(); m.step()
    if d.rpdo_size >= 0 and d.tpdo_size >= 0: d.exchange(bytes(d.rpdo_size))
# each object at its ends
d = Drive()
for name, (kind, *_) in record.OD.fields.items():
    for value in (np.iinfo(kind.base).max, np.iinfo(kind.base).min, 99):
        d.reset(); d.write("controlword", 6); d.cycle(0.0)
        d.axes["od"][name] = value; d.cycle(0.0); d.cycle(0.1)
# angles that are none
d = Drive()
for wrong in (np.nan, np.inf, -1e308, 1e18): d.cycle(wrong, wrong)
# a drive that is not there, images of another size
d = Drive(); refused(ValueError, "bytes", d.latch, b""); refused(ValueError, "bytes", d.latch, bytes(10**6))
refused(ValueError, "bytes", d.unpack, b"x")
# actions that are none
e = LinearAxisEnv(); e.reset(seed=1)
for wrong in (np.zeros(0), np.zeros(99), [np.nan], [7.0], None, "x"):
    refused((ValueError, TypeError), "", e.step, wrong)
v = vector(2)
for wrong in (np.zeros((3, 1)), np.zeros(2), np.full((2, 1), np.nan), np.zeros((2, 10**4))):
    refused(ValueError, "action", v.step, wrong)
# a delay out of the step
m = linear_axis(); m.world["delay"] = -5; m.step(); m.world["delay"] = 10**12; m.step()
""",  # noqa: E501
}


def cases(text):
    """Name and code of each case: what follows a comment at the beginning of a line."""
    found = []
    for line in text.strip().splitlines():
        if line.startswith("# "):
            found.append((line[2:], []))
        else:
            found[-1][1].append(line)
    return [(name, "\n".join(lines)) for name, lines in found]


def test_there_are_more_than_sixty_ways():
    assert sum(len(cases(text)) for text in GROUPS.values()) > 60


FORKS = """
linear_axis().step()
vector(threads=2).close()  # what is compiled is loaded
gc.collect(); gc.freeze()  # what cases collect is their own
for name, program in json.loads(sys.stdin.read()).items():
    sys.stdout.flush()
    child = os.fork()
    if not child:
        for stream, number, end in ((sys.stdout, 1, "out"), (sys.stderr, 2, "err")):
            os.dup2(os.open(f"{sys.argv[1]}/{name}.{end}", os.O_CREAT | os.O_WRONLY), number)
            stream.reconfigure(line_buffering=True)
        exec(compile(program, name, "exec"), globals())
        sys.exit()
    print(json.dumps([name, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])]))
"""


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """Exit status, output and errors of each group."""
    folder = tmp_path_factory.mktemp("groups")
    programs = {
        group: "".join(f"print({name!r}, flush=True)\n{code}\n" for name, code in cases(text))
        for group, text in GROUPS.items()
    }
    done = subprocess.run(
        [sys.executable, "-c", f"import json\n{BEGIN}\n{FORKS}", str(folder)],
        input=json.dumps(programs), capture_output=True, text=True, timeout=600,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    said = dict(json.loads(line) for line in done.stdout.splitlines())
    return {
        group: (status, *((folder / f"{group}.{end}").read_text() for end in ("out", "err")))
        for group, status in said.items()
    }


@pytest.mark.parametrize("group", GROUPS)
def test_no_way_crashes_the_interpreter(ended, group):
    status, out, err = ended[group]
    last = out.strip().rpartition("\n")[2]
    assert status == 0, f"{last}: {status}\n{err[-3000:]}"
    assert last == cases(GROUPS[group])[-1][0]
