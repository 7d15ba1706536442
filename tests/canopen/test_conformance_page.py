"""docs/results/conformance.md: the cases of the conformance tests, run, with result and reason.

``SERVOGYM_WRITE=1 pytest tests/canopen/test_conformance_page.py`` writes it anew.
"""

import os
from pathlib import Path

import test_conformance
import test_conformance_services as services
from conformance import Bus

PAGE = Path(__file__).parents[2] / "docs" / "results" / "conformance.md"
HEAD = """# Conformance of the CAN node

The tests play cases of CiA 301 and CiA 305, written as lists of frames, against the `generic`
drive. `tests/canopen/test_conformance.py` and `test_conformance_services.py` list the frames that
each case sends and expects under its name. A result is *as the standard says*; *inferred* if the
standard leaves the behaviour open; or *not supported* if the drive answers that it does not have
the service. `tests/canopen/test_conformance_page.py` writes this page and fails if it is out of
date.

"""
INFERRED = {  # case -> what the standard leaves open
    "pdo: mapping while valid": "the standard gives no code for steps in another order: 06010000h",
    "mapping: entries change only while their number is 0": "as above: 06010000h",
    "rpdo: sync identifier": "a PDO with the identifier of SYNC is refused",
    "heartbeat consumer: reserved bits": "refused as an invalid value",
    "sync: message of two bytes is ignored": "a SYNC of another length is reported and ignored",
    "sync: message of wrong length is ignored": "a SYNC of another length is reported and ignored",
    "sync: start value": "the SYNC with the start value is the first to be answered",
    "lss: silence while the bit rate changes": "no frame is received or sent between the delays",
    "lss: works in stopped": "LSS is active in every NMT state",
}
NOT_SUPPORTED = {
    "time: producer bit": "the drive consumes TIME and does not produce it",
    "sdo server 2: dynamic": "SDO connections are static",
    "sync: identifier of 29 bits": "identifiers have 11 bits",
    "emcy: identifier of 29 bits": "identifiers have 11 bits",
    "rpdo: identifier of 29 bits": "identifiers have 11 bits",
    "extended frame": "identifiers have 11 bits",
}


def result(name, script, node_id):
    """Result and reason of a case, which is run."""
    try:
        Bus(node_id).run(script)
    except AssertionError as error:
        return "**differs**", str(error).partition("\n")[0]
    if name in NOT_SUPPORTED:
        return "not supported", NOT_SUPPORTED[name]
    return ("inferred", INFERRED[name]) if name in INFERRED else ("as the standard says", "")


def page():
    cases = [(name, script, 1) for name, script in test_conformance.CASES.items()]
    cases += [(name, script, 1) for name, script in services.CASES.items()]
    cases += [(name, script, 255) for name, script in services.UNCONFIGURED.items()]
    rows = [(name, *result(name, script, node_id)) for name, script, node_id in cases]
    assert {*INFERRED, *NOT_SUPPORTED} <= {name for name, _, _ in rows}
    results = [result for _, result, _ in rows]
    counts = ", ".join(f"{results.count(kind)} {kind}" for kind in dict.fromkeys(results))
    lines = [f"| {name} | {result} | {reason} |" for name, result, reason in sorted(rows)]
    table = ["| case | result | reason |", "|---|---|---|", *lines]
    return HEAD + f"{len(rows)} cases: {counts}.\n\n" + "\n".join(table) + "\n"


def test_the_page_says_what_the_cases_give():
    text = page()
    if os.environ.get("SERVOGYM_WRITE"):
        PAGE.write_text(text, encoding="utf-8")
    assert PAGE.read_text(encoding="utf-8") == text
    assert "differs" not in text
