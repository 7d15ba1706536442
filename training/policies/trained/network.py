"""A compiled network of a few layers whose sums have a fixed order: equal bits on any processor.

Matrix libraries, and NumPy for tanh, choose the order of their sums and their approximations by the
processor. The last bit then differs between machines, and after some hundred steps of a task so
does everything.
"""

import numpy as np

from ....drive.kernel.jit import block, entry

ZERO, ONE = np.array([0.0, 1.0], np.float32)
TANH, RELU, CLIP = range(3)  # activations
# tanh as a rational function (that of Eigen), accurate to 4e-7 and vectorised by the compiler
FLAT = np.float32(7.90531110763549805)  # beyond it tanh is 1
A0, A1, A2, A3, A4, A5, A6 = np.array([
    -2.76076847742355e-16, 2.00018790482477e-13, -8.60467152213735e-11, 5.12229709037114e-08,
    1.48572235717979e-05, 6.37261928875436e-04, 4.89352455891786e-03,
], np.float32)
B0, B1, B2, B3 = np.array([
    1.19825839466702e-06, 1.18534705686654e-04, 2.26843463243900e-03, 4.89352518554385e-03,
], np.float32)


@block
def tanh(z):
    """Replace each number of an array by its hyperbolic tangent."""
    for i in range(z.shape[0]):
        x = min(max(z[i], -FLAT), FLAT)
        s = x * x
        above = (((((A0 * s + A1) * s + A2) * s + A3) * s + A4) * s + A5) * s + A6
        z[i] = x * above / (((B0 * s + B1) * s + B2) * s + B3)


@block
def _shape(z, does):
    if does == TANH:
        tanh(z)
    else:
        low = ZERO if does == RELU else -ONE
        for i in range(z.shape[0]):
            z[i] = max(z[i], low)
            if does == CLIP:
                z[i] = min(z[i], ONE)


@entry
def forward(numbers, widths, inner, last, seen, output):
    """Write the output of the network for an input.

    Args:
        numbers: for each layer its weights, (inputs, outputs), then its biases, float32.
        widths: of the input and of the output of each layer.
        inner: activation of all layers but the last: TANH, RELU or CLIP.
        last: activation of the last layer.
        seen: input, shape ``(widths[0],)``, float32.
        output: output to be written, shape ``(widths[-1],)``, float32.
    """
    x, begin = seen, 0
    for layer in range(widths.shape[0] - 1):
        inputs, outputs = widths[layer], widths[layer + 1]
        middle = begin + inputs * outputs
        w = numbers[begin:middle].reshape(inputs, outputs)
        begin = middle + outputs
        z = numbers[middle:begin].copy()
        for k in range(inputs):
            for j in range(outputs):
                z[j] += w[k, j] * x[k]
        _shape(z, last if layer == widths.shape[0] - 2 else inner)
        x = z
    output[:] = x
