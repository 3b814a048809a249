# ruff: noqa: ARG001  (an intrinsic has the arguments that numba asks for)
"""Elementary functions that LLVM can vectorise: what kernels and effects use in place of `math`.

A call into the C library in a loop over lanes silently turns vectorisation off (a factor of four to six), so these are
plain arithmetic: range reduction, a polynomial (near-minimax, fitted with mpmath at 40 digits) and bit shifts.
Every function takes and gives floats. Each states its error, and is tested against numpy.
"""

from __future__ import annotations

import bayes_damper.rig.unsteered_numba  # noqa: F401

# isort: split
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

# Flags that change no value that matters; never reassociation, which would undo the rounding trick below.
FASTMATH = {"nnan", "ninf", "nsz", "contract", "arcp"}

_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding it rounds to the nearest integer, which the low bits then hold
_LOG2E = 1.4426950408889634
TANH_SCALE = 2.0 * _LOG2E
# Coefficients of a (1 + b1 a + b2 a^2 + b3 a^3) / (1 + b1 a + d2 a^2 + d3 a^3 + b3 a^4), in the order b1 b2 b3 d2 d3: a
# at 0 with no square beside it, and 1 far away, as a / sqrt(1 + a^2) and 2/pi arctan(pi/2 a) are.
_ROOT = (1.85893258, 1.87079489, 1.01992175, 2.38248177, 1.87001893)
_ARC = (3.03063368, 4.97731776, 4.62421059, 5.82577683, 6.84993574)
_LN2_HIGH = 0.693147180369123816490
_LN2_LOW = 1.90821492927058770002e-10
_PI_HIGH = 3.141592502593994
_PI_MIDDLE = 1.5099578831723193e-07
_PI_LOW = 1.0780605716316238e-14


@intrinsic
def _bits(typing_context: Any, x: Any) -> Any:
    """The 64 bits of a float, as an integer."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), build


@intrinsic
def _float(typing_context: Any, x: Any) -> Any:
    """The float that has these 64 bits."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.int64), build


lane = njit(forceinline=True, fastmath=FASTMATH, error_model="numpy")
"""Decorator of every function that is called inside the loop over lanes: compiled, inlined, vectorised."""


@lane
def _power(y):
    """2 ** y, for y cut to +-60, relative error below 4e-14.

    The polynomial is evaluated in pairs (Estrin), because a step waits for it: half the latency of Horner's rule.
    """
    clipped = min(max(y, -60.0), 60.0)
    shifted = clipped + _ROUND
    f = clipped - (shifted - _ROUND)
    f2 = f * f
    f4 = f2 * f2
    q01 = 0.2402265069581299 * f + 0.6931471805599453
    q23 = 0.009618129159402558 * f + 0.055504108664760424
    q45 = 0.00015403455852453838 * f + 0.0013333558179043112
    q67 = 1.3255224878668817e-06 * f + 1.525268684626772e-05
    high = 1.0203121063391729e-07 * f4 + (q67 * f2 + q45)
    q = high * f4 + (q23 * f2 + q01)
    return _float(_bits(f * q + 1.0) + (_bits(shifted) << 52))


@lane
def tanh_scaled(y):
    """tanh(y / TANH_SCALE), absolute error below 2e-14: for callers that scale many arguments by one factor."""
    power = _power(y)
    return (power - 1.0) / (power + 1.0)


@lane
def tanh(x: float) -> float:
    """Hyperbolic tangent; absolute error below 2e-14, tanh(0) = 0 exactly."""
    return tanh_scaled(TANH_SCALE * x)


@lane
def smooth_sign_scaled(y, tail):
    """The curve along which dry friction changes its sign, at x = y / TANH_SCALE, and its derivative by x.

        tail 0: tanh(x),    1/2: x / sqrt(1 + x^2),    1: (2/pi) arctan(pi/2 x),    between them the parabola in `tail`

    All begin as x and end at 1, the later ones the more slowly. The second and third are rational functions of |x|
    (minimax, fitted with numpy), to 1.3e-5; tanh is exact to 4e-14.
    """
    power = _power(y)
    a = abs(y) * (1.0 / TANH_SCALE)
    top1 = 1.0 + a * (_ROOT[0] + a * (_ROOT[1] + a * _ROOT[2]))
    low1 = 1.0 + a * (_ROOT[0] + a * (_ROOT[3] + a * (_ROOT[4] + a * _ROOT[2])))
    top2 = 1.0 + a * (_ARC[0] + a * (_ARC[1] + a * _ARC[2]))
    low2 = 1.0 + a * (_ARC[0] + a * (_ARC[3] + a * (_ARC[4] + a * _ARC[2])))
    both = low1 * low2
    inverse = 1.0 / ((power + 1.0) * both)
    rest = (power + 1.0) * inverse
    sharp = (power - 1.0) * both * inverse
    over1 = low2 * rest
    over2 = low1 * rest
    size1 = a * top1 * over1
    size2 = a * top2 * over2
    w1 = 4.0 * tail * (1.0 - tail)
    w2 = tail * (2.0 * tail - 1.0)
    w0 = 1.0 - w1 - w2
    grow1 = 1.0 + a * (2.0 * _ROOT[0] + a * (3.0 * _ROOT[1] + a * (4.0 * _ROOT[2])))
    grow2 = 1.0 + a * (2.0 * _ARC[0] + a * (3.0 * _ARC[1] + a * (4.0 * _ARC[2])))
    fall1 = _ROOT[0] + a * (2.0 * _ROOT[3] + a * (3.0 * _ROOT[4] + a * (4.0 * _ROOT[2])))
    fall2 = _ARC[0] + a * (2.0 * _ARC[3] + a * (3.0 * _ARC[4] + a * (4.0 * _ARC[2])))
    slope = w0 * (1.0 - sharp * sharp) + w1 * (grow1 - size1 * fall1) * over1 + w2 * (grow2 - size2 * fall2) * over2
    slow = w1 * size1 + w2 * size2
    return w0 * sharp + (slow if y > 0.0 else -slow), slope


@lane
def smooth_sign(x, tail):
    """The curve along which dry friction changes its sign (`smooth_sign_scaled`), at x."""
    return smooth_sign_scaled(TANH_SCALE * x, tail)[0]


@lane
def exp(x: float) -> float:
    """Exponential of x, which is cut to +-700; relative error below 1e-15 for |x| < 1, 2e-15 |x| beyond."""
    y = min(max(x, -700.0), 700.0)
    shifted = _LOG2E * y + _ROUND
    k = shifted - _ROUND
    f = _LOG2E * ((y - k * _LN2_HIGH) - k * _LN2_LOW)
    q = 4.4558179083360645e-10 * f + 7.074194297288521e-09
    q = q * f + 1.0178057087733941e-07
    q = q * f + 1.3215432535912375e-06
    q = q * f + 1.5252733841556773e-05
    q = q * f + 0.00015403530463724353
    q = q * f + 0.001333355814640647
    q = q * f + 0.009618129107587256
    q = q * f + 0.055504108664821625
    q = q * f + 0.24022650695910158
    q = q * f + 0.6931471805599453
    return _float(_bits(1.0 + f * q) + (_bits(shifted) << 52))


@lane
def log(x: float) -> float:
    """Natural logarithm of x, which is raised to 1e-300 where smaller."""
    y = max(x, 1e-300)
    bits = _bits(y)
    # The exponent is chosen so that the mantissa lies within [1/sqrt(2), sqrt(2)].
    exponent = (bits - 4604544271217802189) >> 52
    m = _float(bits - (exponent << 52))
    s = (m - 1.0) / (m + 1.0)
    u = s * s
    q = 0.14809710360655276 * u + 0.1531252814836419
    q = q * u + 0.18183631680229329
    q = q * u + 0.22222197056726048
    q = q * u + 0.2857142876064168
    q = q * u + 0.3999999999930234
    q = q * u + 0.6666666666666765
    k = float(exponent)
    return k * _LN2_HIGH + (k * _LN2_LOW + s * (2.0 + u * q))


@lane
def sin(x: float) -> float:
    """Sine of x in rad, |x| <= 1e5."""
    shifted = x * 0.3183098861837907 + _ROUND
    k = shifted - _ROUND
    f = ((x - k * _PI_HIGH) - k * _PI_MIDDLE) - k * _PI_LOW
    u = f * f
    q = 2.7215749422983443e-15 * u - 7.643026557971632e-13
    q = q * u + 1.605894087848656e-10
    q = q * u - 2.505210689056952e-08
    q = q * u + 2.7557319211229606e-06
    q = q * u - 0.00019841269841208676
    q = q * u + 0.008333333333333186
    q = q * u - 0.16666666666666666
    value = f + f * u * q
    return _float(_bits(value) ^ (_bits(shifted) << 63))  # an odd number of half turns changes the sign


@lane
def cos(x: float) -> float:
    """Cosine of x in rad, |x| <= 1e5."""
    return sin(x + 1.5707963267948966)


@lane
def fourth_root_of_inverse(x: float) -> float:
    """Give x ** -0.25 for x > 0, to 4 %: what a step-size controller needs, without a root or a logarithm."""
    return _float(5758712311122007040 - (_bits(x) >> 2))
