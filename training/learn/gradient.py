"""The arithmetic of PPO, compiled: two networks of tanh layers, their gradients, and Adam.

The same formulas as stable-baselines3 with torch (Schulman et al. 2017, Kingma & Ba 2015), in
float32, written out for networks this small: rows pass through all layers in blocks that stay in
the cache, and nothing is kept for a graph. All numbers of both networks lie in one array: the
logarithm of the standard deviation of each action, then of each layer of the actor and of the
critic the weights (outputs, inputs) and the biases.
"""

import math

import numpy as np

from ...drive.kernel.jit import block, entry
from ..policies.trained.network import ONE, ZERO, tanh

ROWS = 32  # of a block: all their numbers fit into the first cache
HALF_LOG_TAU = np.float32(0.5 * math.log(2.0 * math.pi))
HALF, TWO = np.array([0.5, 2.0], np.float32)
SETTINGS = np.dtype([
    ("batch", "i8"),
    ("rate", "f8"), ("beta1", "f8"), ("beta2", "f8"), ("epsilon", "f8"),  # of Adam
    ("longest", "f8"),  # gradient, by its norm
    ("clip", "f4"), ("entropy", "f4"), ("value", "f4"),  # range of the ratio; weights in the loss
])  # fmt: skip
LOSSES = np.dtype([("policy", "f8"), ("value", "f8"), ("divergence", "f8"), ("clipped", "f8")])


@block
def _times(left, right, to, rows, inner, width):
    """Add the product of two matrices, four rows and four numbers of each at a time.

    `to` and `right` are read along their rows, which the compiler vectorises.
    """
    whole_rows, whole = rows // 4 * 4, inner // 4 * 4
    for r in range(0, whole_rows, 4):
        for k in range(0, whole, 4):
            aa, ab, ac, ad = left[r, k], left[r, k + 1], left[r, k + 2], left[r, k + 3]
            ba, bb, bc, bd = (
                left[r + 1, k],
                left[r + 1, k + 1],
                left[r + 1, k + 2],
                left[r + 1, k + 3],
            )
            ca, cb, cc, cd = (
                left[r + 2, k],
                left[r + 2, k + 1],
                left[r + 2, k + 2],
                left[r + 2, k + 3],
            )
            da, db, dc, dd = (
                left[r + 3, k],
                left[r + 3, k + 1],
                left[r + 3, k + 2],
                left[r + 3, k + 3],
            )
            for j in range(width):
                a, b, c, d = right[k, j], right[k + 1, j], right[k + 2, j], right[k + 3, j]
                to[r, j] += aa * a + ab * b + ac * c + ad * d
                to[r + 1, j] += ba * a + bb * b + bc * c + bd * d
                to[r + 2, j] += ca * a + cb * b + cc * c + cd * d
                to[r + 3, j] += da * a + db * b + dc * c + dd * d
        for k in range(whole, inner):
            aa, ba, ca, da = left[r, k], left[r + 1, k], left[r + 2, k], left[r + 3, k]
            for j in range(width):
                a = right[k, j]
                to[r, j] += aa * a
                to[r + 1, j] += ba * a
                to[r + 2, j] += ca * a
                to[r + 3, j] += da * a
    for r in range(whole_rows, rows):
        for k in range(inner):
            aa = left[r, k]
            for j in range(width):
                to[r, j] += aa * right[k, j]


@block
def _layer(numbers, widths, begin, i):
    """Weights and biases of layer `i` of a network that begins at `begin`."""
    for before in range(i):
        begin += (widths[before] + 1) * widths[before + 1]
    inputs, outputs = widths[i], widths[i + 1]
    middle = begin + inputs * outputs
    return numbers[begin:middle].reshape(outputs, inputs), numbers[middle : middle + outputs]


@block
def _turn(numbers, widths, begin, turned):
    """The weights of each layer as (inputs, outputs)."""
    for i in range(widths.shape[0] - 1):
        w, _ = _layer(numbers, widths, begin, i)
        to = turned[i, : w.size].reshape(w.shape[1], w.shape[0])
        for j in range(w.shape[0]):
            for k in range(w.shape[1]):
                to[k, j] = w[j, k]


@block
def _forward(numbers, widths, begin, turned, n, told):
    """What each layer tells of n rows, of which ``told[0]`` has what the first one sees."""
    last = widths.shape[0] - 2
    for i in range(last + 1):
        w, b = _layer(numbers, widths, begin, i)
        z = told[i + 1]
        for r in range(n):
            z[r, : b.shape[0]] = b
        outputs, inputs = w.shape
        _times(told[i], turned[i, : w.size].reshape(inputs, outputs), z, n, inputs, outputs)
        if i < last:
            for r in range(n):
                tanh(z[r, : b.shape[0]])


@block
def _backward(numbers, gradient, widths, begin, n, told, d, spare):
    """Add the gradients of n rows, of which d is the derivative of what the last layer told."""
    for i in range(widths.shape[0] - 2, -1, -1):
        to, biases = _layer(gradient, widths, begin, i)
        for r in range(n):
            for j in range(widths[i + 1]):
                biases[j] += d[r, j]
        _times(d.T, told[i], to, widths[i + 1], n, widths[i])
        if i > 0:
            w, _ = _layer(numbers, widths, begin, i)
            for r in range(n):
                spare[r, : widths[i]] = ZERO
            _times(d, w, spare, n, widths[i + 1], widths[i])
            for r in range(n):
                row, x = spare[r], told[i, r]
                for k in range(widths[i]):
                    row[k] *= ONE - x[k] * x[k]
            d, spare = spare, d


@block
def _room(actor, critic):
    """For both networks: what is told by layers, derivatives twice, weights turned round."""
    layers, widest = max(actor.shape[0], critic.shape[0]), max(actor.max(), critic.max())
    told = np.empty((layers, ROWS, widest), np.float32)
    derivatives = np.empty((2, ROWS, widest), np.float32)
    return told, derivatives, np.empty((layers, widest * widest), np.float32)


@block
def _size(widths):
    size = 0
    for i in range(widths.shape[0] - 1):
        size += (widths[i] + 1) * widths[i + 1]
    return size


@entry
def tell(numbers, actor, critic, seen, means, values):
    """Mean actions and values for what is seen, row by row.

    Args:
        numbers: of both networks, as at the top.
        actor: widths of its layers: what is seen, hidden ones, actions.
        critic: widths of its layers; the last is 1.
        seen: shape ``(n, width)``, float32.
        means: to write, shape ``(n, actions)``, float32.
        values: to write, shape ``(n,)``, float32.
    """
    told, _, turned = _room(actor, critic)
    actions = means.shape[1]
    for network in range(2):
        widths, begin = (actor, actions) if network == 0 else (critic, actions + _size(actor))
        _turn(numbers, widths, begin, turned)
        for first in range(0, seen.shape[0], ROWS):
            n = min(ROWS, seen.shape[0] - first)
            told[0, :n, : seen.shape[1]] = seen[first : first + n]
            _forward(numbers, widths, begin, turned, n, told)
            out = told[widths.shape[0] - 1]
            for r in range(n):
                if network == 0:
                    means[first + r] = out[r, :actions]
                else:
                    values[first + r] = out[r, 0]


@block
def _act(numbers, gradient, out, d, rows, taken, before, gains, clip, share, losses):
    """Loss of the actor in some rows: its derivative by the means, and by the deviations."""
    actions = taken.shape[1]
    for r in range(rows.shape[0]):
        row = rows[r]
        chance = ZERO
        for j in range(actions):
            off = (taken[row, j] - out[r, j]) * math.exp(-numbers[j])
            d[r, j] = off
            chance -= HALF * off * off + numbers[j] + HALF_LOG_TAU
        change = chance - before[row]
        ratio = math.exp(change)
        plain = gains[r] * ratio
        clipped = gains[r] * min(max(ratio, ONE - clip), ONE + clip)
        losses.policy -= min(plain, clipped)
        losses.divergence += ratio - ONE - change
        losses.clipped += abs(ratio - ONE) > clip
        slope = -plain * share if plain <= clipped else ZERO
        for j in range(actions):
            off = d[r, j]
            d[r, j] = slope * off * math.exp(-numbers[j])
            gradient[j] += slope * (off * off - ONE)


@block
def _descend(numbers, gradient, first, second, count, given):
    """One step of Adam, with a gradient that is no longer than it may be."""
    squares = 0.0
    for i in range(gradient.shape[0]):
        squares += gradient[i] * gradient[i]
    shorter = np.float32(min(given.longest / (math.sqrt(squares) + 1e-6), 1.0))
    beta1, beta2 = np.float32(given.beta1), np.float32(given.beta2)
    rate = np.float32(given.rate / (1.0 - given.beta1**count))
    scale = np.float32(1.0 / math.sqrt(1.0 - given.beta2**count))
    epsilon = np.float32(given.epsilon)
    for i in range(gradient.shape[0]):
        g = gradient[i] * shorter
        first[i] += (g - first[i]) * (ONE - beta1)
        second[i] = second[i] * beta2 + g * g * (ONE - beta2)
        numbers[i] -= rate * first[i] / (np.sqrt(second[i]) * scale + epsilon)


@entry
def update(numbers, first, second, count, actor, critic, seen, taken, before, advantages, returns,
           orders, given, losses):  # fmt: skip
    """All epochs of an update of PPO.

    Args:
        numbers: of both networks, as at the top; changed.
        first: moments of Adam, as many; changed.
        second: likewise.
        count: steps of Adam until now.
        actor: widths of its layers.
        critic: widths of its layers.
        seen: of a rollout, shape ``(n, width)``, float32.
        taken: actions, shape ``(n, actions)``, float32.
        before: logarithms of the chances they had, shape ``(n,)``, float32.
        advantages: shape ``(n,)``, float32.
        returns: shape ``(n,)``, float32.
        orders: of the rows, one an epoch, shape ``(epochs, n)``.
        given: a record of `SETTINGS`.
        losses: records of `LOSSES` to write, one a batch of each epoch, zeros.
    """
    told, derivatives, turned = _room(actor, critic)
    gradient, gains = np.empty_like(numbers), np.empty(ROWS, np.float32)
    actions = taken.shape[1]
    at = 0
    for epoch in range(orders.shape[0]):
        for start in range(0, orders.shape[1], given.batch):
            rows = orders[epoch, start : start + given.batch]
            n = rows.shape[0]
            share = ONE / np.float32(n)
            mean, squares = 0.0, 0.0
            for r in range(n):
                mean += advantages[rows[r]] / n
            for r in range(n):
                squares += (advantages[rows[r]] - mean) ** 2
            deviation = math.sqrt(squares / (n - 1)) + 1e-8 if n > 1 else 1.0
            centre = mean if n > 1 else 0.0
            gradient[:] = ZERO
            gradient[:actions] = -given.entropy
            for network in range(2):
                widths = actor if network == 0 else critic
                begin = actions if network == 0 else actions + _size(actor)
                _turn(numbers, widths, begin, turned)
                for some in range(0, n, ROWS):
                    few = rows[some : some + ROWS]
                    for r in range(few.shape[0]):
                        told[0, r, : seen.shape[1]] = seen[few[r]]
                        gains[r] = (advantages[few[r]] - centre) / deviation
                    _forward(numbers, widths, begin, turned, few.shape[0], told)
                    out, d = told[widths.shape[0] - 1], derivatives[0]
                    if network == 0:
                        _act(numbers, gradient, out, d, few, taken, before, gains, given.clip,
                             share, losses[at])  # fmt: skip
                    else:
                        for r in range(few.shape[0]):
                            off = out[r, 0] - returns[few[r]]
                            losses[at].value += off * off
                            d[r, 0] = TWO * given.value * off * share
                    _backward(numbers, gradient, widths, begin, few.shape[0], told, d,
                              derivatives[1])  # fmt: skip
            count += 1
            _descend(numbers, gradient, first, second, count, given)
            losses[at].policy /= n
            losses[at].value /= n
            losses[at].divergence /= n
            losses[at].clipped /= n
            at += 1
