"""ethercrab on the wire: the program of the folder beside it, built by cargo."""

import json
import subprocess


def reach_op(program, cycles, period=0):
    """INIT to OP, with SYNC0 where there is a period (ms), and cycles; -> what it has printed."""
    done = subprocess.run(
        [program, "vb", str(cycles), str(period)],
        capture_output=True, text=True, timeout=280, check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])
