"""SOEM's own samples on the wire, built from its sources."""

import re
import subprocess


def slaveinfo(program):
    """What it prints of each slave: name, bits of process data, delay, identity."""
    done = subprocess.run([program, "vb"], capture_output=True, text=True, timeout=120, check=False)
    if "slaves found" not in done.stdout:
        raise RuntimeError(f"the scan did not go on in time: {done.stdout}")
    rows = re.findall(
        r"Slave:\d+\s+Name:(.*)\s+Output size: (\d+)bits\s+Input size: (\d+)bits\s+State: (\d+)"
        r"\s+Delay: (\d+)\[ns\](?:.|\n)*?Man: (\w+) ID: (\w+) Rev: (\w+)",
        done.stdout,
    )
    return [[row[0].strip(), *map(int, row[1:5]), *(int(n, 16) for n in row[5:])] for row in rows]


def simple_ng(program, cycles):
    """OP, then `cycles` lines of its 10,000; -> what it printed before, and working counters."""
    with subprocess.Popen(
        [program, "vb"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as running:
        before, counters = [], []
        for line in running.stdout:
            if found := re.search(r"Iteration\s+\d+:.*WKC\s+(\d+)", line):
                counters.append(int(found[1]))
            elif not counters:
                before.append(line.strip())
            if len(counters) == cycles:
                break
        running.terminate()
    return {"before": before, "counters": counters}
