"""What is played has the same bits whatever processor plays it.

Libraries choose by the processor how they add and approximate; by their own variables they take
what another one would get.
"""

import hashlib
import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from numpy._core._multiarray_umath import __cpu_features__ as features

from servogym.envs import TASKS
from servogym.envs.environment.registry import short
from servogym.training.evaluate.comparison import evaluate
from servogym.training.policies import POLICIES
from servogym.training.policies.trained.network import CLIP, RELU, TANH, forward

WIDE = [name for name in ("X86_V4", "AVX512_ICL", "AVX512_SPR") if features.get(name)]
OTHERS = {  # variables under which libraries believe in another processor
    "blas": {"OPENBLAS_CORETYPE": "Prescott"},
    "numpy": {"NPY_DISABLE_CPU_FEATURES": " ".join(WIDE)},
    "numba": {"NUMBA_CPU_NAME": "haswell"},
}
QUICK = ["LinearAxis-v0 learned", "LinearAxisTracking-v0 hold"]  # differed most easily


def digests(cases):
    """A line a case: task, policy, and a digest of all values of three episodes."""
    lines = []
    for case in cases:
        env, policy = case.split()
        try:
            (result,) = evaluate(env, [policy], "generic", 3, 5)
        except ValueError:  # the policy does not fit the task
            continue
        values = [np.asarray(v, float).tobytes() for _, v in sorted(result.values.items())]
        lines.append(f"{case} {hashlib.sha256(b''.join(values)).hexdigest()}")
    return lines


def elsewhere(cases, variables):
    done = subprocess.run(
        [sys.executable, __file__, *cases],
        capture_output=True, text=True, check=True, env=os.environ | variables,
    )
    return done.stdout.splitlines()


def test_another_processor_plays_the_same():
    assert elsewhere(QUICK, OTHERS["blas"] | OTHERS["numpy"]) == digests(QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("of", OTHERS)
def test_another_processor_plays_every_policy_the_same(of, tmp_path):
    cases = [f"{short(task.ID)} {policy}" for task in TASKS for policy in ("learned", *POLICIES)]
    here = digests(cases)
    assert len(here) > 60
    assert elsewhere(cases, OTHERS[of] | {"SERVOGYM_CACHE_DIR": str(tmp_path)}) == here


@pytest.mark.parametrize("last", [CLIP, RELU, TANH])
@pytest.mark.parametrize("widths", [(5, 3), (14, 64, 64, 2), (1, 1, 1)])
def test_sums_are_added_one_after_the_other(widths, last):
    """To the bit as NumPy adds two arrays, product by product: no fused multiply-add."""
    generator = np.random.default_rng(sum(widths))
    layers = [
        (generator.normal(size=pair).astype(np.float32),
         generator.normal(size=pair[1]).astype(np.float32))
        for pair in pairwise(widths)
    ]
    numbers = np.concatenate([part.ravel() for layer in layers for part in layer])
    for _ in range(50):
        seen = generator.normal(size=widths[0]).astype(np.float32)
        told = np.empty(widths[-1], np.float32)
        forward(numbers, np.array(widths), RELU, last, seen, told)
        x = seen
        for i, (w, b) in enumerate(layers):
            z = b.copy()
            for row, number in zip(w, x, strict=True):
                z = z + row * number
            inner = i < len(layers) - 1
            x = np.maximum(z, 0) if inner or last == RELU else z
        if last == TANH:
            np.testing.assert_allclose(told, np.tanh(x.astype(float)), atol=4e-7, rtol=4e-7)
        else:
            expected = np.clip(x, -1, 1) if last == CLIP else x
            assert told.tobytes() == expected.astype(np.float32).tobytes()


if __name__ == "__main__":
    print("\n".join(digests(sys.argv[1:])))
