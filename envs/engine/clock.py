"""Stops MuJoCo's clock for threads that step a machine, and only for those.

With the settings of the Python package, a step of one axis reads the clock some fifty times for
``MjData.timer``, which takes nearly as long as the physics. `clock` installs a reader that returns
0 in a thread inside the context and calls MuJoCo's reader in all others. The timers of machines
therefore count calls but no time, and those of any other MjData work as usual. A clock of the
user's own (`mujoco.set_mjcb_time`) is kept, and so is MuJoCo's reader if threads are not POSIX
threads.
"""

import ctypes
import os
import sys
from typing import Any

import llvmlite.binding as llvm

from ...drive.kernel.jit import DISABLED
from .physics import LIBRARY

KEY: Any = ctypes.c_ulong if sys.platform == "darwin" else ctypes.c_uint  # pthread_key_t
SOURCE = """
declare ptr @pthread_getspecific(i{bits})
define double @read() {{
  %mark = call ptr @pthread_getspecific(i{bits} {key})
  %outside = icmp eq ptr %mark, null
  br i1 %outside, label %ask, label %answer
answer:
  ret double 0.0
ask:
  %reader = inttoptr i64 {reader} to ptr
  %now = tail call double %reader()
  ret double %now
}}
"""


class _Clock:
    """A context in which MuJoCo's clock returns 0 to the calling thread; it is not re-entrant."""

    def __init__(self) -> None:
        self._read = ctypes.c_void_p.in_dll(ctypes.CDLL(LIBRARY), "mjcb_time")
        self._of_mujoco = self._read.value
        self._ours: int | None = None
        if not DISABLED and self._of_mujoco and os.name == "posix":
            self._threads: Any = ctypes.PyDLL(None)
            key = KEY()
            if self._threads.pthread_key_create(ctypes.byref(key), None) == 0:
                self._key = key
                self._ours = self._compiled(key.value, self._of_mujoco)

    def _compiled(self, key: int, reader: int) -> int:
        """Return the address of a reader that calls the one at `reader` outside of the context."""
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        target = llvm.Target.from_default_triple().create_target_machine(opt=3)
        text = SOURCE.format(bits=8 * ctypes.sizeof(KEY), key=key, reader=reader)
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(text), target)
        engine.finalize_object()
        address = engine.get_function_address("read")
        engine.detach()  # MuJoCo may call it as long as the process lives
        return address

    def __enter__(self) -> None:
        if self._ours is not None:
            if self._read.value == self._of_mujoco:
                self._read.value = self._ours
            self._threads.pthread_setspecific(self._key, ctypes.c_void_p(1))

    def __exit__(self, *_: object) -> None:
        if self._ours is not None:
            self._threads.pthread_setspecific(self._key, None)


clock = _Clock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=clock.__exit__)  # the thread that forks may be inside
