# ruff: noqa: ARG001  (every hook of an effect has the same arguments, needed or not)
"""Stepping in time: an adaptive Rosenbrock method of order 4 for 16 parameter vectors (lanes) at once.

Method: Kaps & Rentrop (1979) with the coefficients of Shampine (1982, ACM TOMS 8, 93), 4 stages, 3 evaluations of the
torques, an embedded error of order 3. Chosen over explicit and other implicit schemes because the cost hardly
depends on nu: with tanh(nu w) friction an explicit step must stay below 2.8 / (nu F (1/J1 + 1/J2)), and one that does
not stays bounded and plausible while the friction is wrong.

How it is laid out, and why:

- Angles are eliminated from each stage (th' = w), so that a stage solves 2 x 2 for the velocities; memory states of an
  effect are eliminated by a Schur complement.
- One loop over 16 lanes holds one whole step, so that LLVM vectorises it: plain arithmetic, vector_math.tanh, selects
  instead of branches, an integer reduction, one work array with a row per quantity.
- Every lane has its own step size and its own place in the record and never sees the others: no lane waits for one
  whose friction is just reversing, and a record is bitwise the same alone and in any batch.
- Steps land on every sample and are never longer than 1 ms: a free step can jump over a reversal of the friction.
- The reading at a sample is the first stage of the next step: observing costs nothing.
- The Jacobian of the nominal rig is exact; that of an effect is a difference quotient along the directions that the
  effect declares (8 digits, more than a Rosenbrock method needs).

There is a kernel for each combination of rig options and effect; what differs between them are small functions that
`advance` calls. Compiling them is the matter of specialised.py: what stands here decides the machine code, and a change
of this file has every kernel compiled anew.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bayes_damper.rig import vector_math
from bayes_damper.rig.equations import Rig, friction_torques, linearised, smooth_torques
from bayes_damper.rig.vector_math import TANH_SCALE, cos, fourth_root_of_inverse, sin

LANES = 16
LONGEST_STEP = 1e-3
PER_GRAVITY = 1.0 / 9.80665  # s^2/m
AT_ONCE = 1e-6  # s, of a release that takes no time; it begins by as much early
MOST_PASSES = 5_000.0  # step attempts within one sample interval before a lane is given up
# Velocity errors allowed per step: a share of the lane's typical speed, and of the width 1 / nu over which friction
# reverses; and the error of the acceleration that they make at once, as a share of its typical size. The last is what
# costs steps during a reversal, and only there. Chosen on 520 random vectors (nu 5 to 3000): largest error 5e-5.
SPEED_TOLERANCE = 3e-6
SWITCH_TOLERANCE = 6e-4
ACCELERATION_TOLERANCE = 4e-5

# Statuses that a lane can end with; outcome.py has the words.
COMPLETED, NOT_FINITE_INPUT, STEP_UNDERFLOW, NOT_FINITE_RECORD = 0, 1, 2, 3

# Shampine's coefficients, in the transformed form that needs no matrix-vector products.
GAMMA = 0.5
A21, A31, A32 = 2.0, 48.0 / 25.0, 6.0 / 25.0
C21, C31, C32 = -8.0, 372.0 / 25.0, 12.0 / 5.0
C41, C42, C43 = -112.0 / 125.0, -54.0 / 125.0, -2.0 / 5.0
B1, B2, B3, B4 = 19.0 / 9.0, 0.5, 25.0 / 108.0, 125.0 / 108.0
E1, E2, E4 = 17.0 / 54.0, 7.0 / 36.0, 125.0 / 108.0
T2, T3 = 1.0, 0.6
G1, G2, G3, G4 = 0.5, -1.5, 2.42, 0.116

# Rows of the block: parameters in the order of equations.ROWS, those of the effect, what is derived from them once,
J1, J2, J12, K1, K3, C1, C3, K2, C2, MU, N0, R_BAR, R_FACE, DRAG, DRAG_RATIO, NU, TAIL = range(17)
THETA0, TH20, W10, W20, DELAY, LETS_GO = range(17, 23)
EXTRA = 23  # and the three after it; MORE has the rest
FRICTION, SLOPE, MI11, MI12, MI22, PER_SPEED, PER_ACC1, PER_ACC2, EPS_TH, EPS_W, HELD1, HELD2 = range(27, 39)
HOLD, FALL = range(39, 41)  # torque that holds the primary at its release, and the share of it that goes in a second
# the state, and what a step leaves behind for the next.
TH1, TH2, W1, W2, Z1, Z2, HTRY, REST, TIME, Y1, Y2, U1, U2, S1, S2, HLAST, FIRST, NOW, AFTER, NEXT = range(41, 61)
SAMPLE, SLOT, ATTEMPTS, GIVEN_UP = range(61, 65)
# Inputs: torques on both bodies and what the ground adds to readings, at the end of this interval with their slopes,
# and the same of the next.
DRIVE1, DRIVE2, SHOWN, RAMP1, RAMP2, RISE = range(65, 71)
DRIVE1_NEXT, DRIVE2_NEXT, SHOWN_NEXT, RAMP1_NEXT, RAMP2_NEXT, RISE_NEXT = range(71, 77)
MORE = 77  # and the seven after it
V1, V2, R1, R2 = range(85, 89)  # second and third states of the sensors
BLOCK_ROWS = 89


@lru_cache(maxsize=None, typed=True)  # True, 1 and 1.0 are equal, but different constants
def constant(value):
    """A kernel without arguments that gives this number or truth value."""

    @vector_math.lane
    def given():
        return value

    return given


# What `advance` is specialised in, all of it functions: these are those of the bare coupled rig.
coupled = constant(True)
pendulum = constant(False)
linear_normal_force = constant(True)
frictionless = constant(False)
driven = constant(False)
swings = constant(False)  # whether the fourth input is the acceleration of a pendulum's pivot
prescribed = constant(False)  # whether the primary moves as the first input says, and channel 1 reads the reaction
curved = constant(False)  # whether dry friction changes its sign along another curve than a tanh
acts = constant(False)  # whether the effect has a torque
couples = constant(2)
timed = constant(False)
senses = constant(False)
starts = constant(False)
memory = constant(0)
memory_scale1 = constant(1.0)
memory_scale2 = constant(1.0)


@vector_math.lane
def effect_torque(t, th1, th2, w1, w2, z1, z2, p, rig):
    """No torque: what stands here without an effect."""
    return 0.0, 0.0


@vector_math.lane
def effect_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """No memory."""
    return 0.0, 0.0


@vector_math.lane
def effect_start(p, rig):
    """Memory states of zero at release."""
    return 0.0, 0.0


@vector_math.lane
def effect_sense(h, u1, u2, y1, y2, s1, s2, v1, v2, r1, r2, p, first):
    """Sensors that show what there is."""
    return y1, y2, s1, s2, v1, v2, r1, r2


def advance(times, parameters, extras, inputs, weights, memory_weights, longest_step, read, out, final, status):
    """Integrate one block of lanes over the sample times and write what the channels read.

    times (LANES, n) s, or (1, n) of all lanes, as records with inputs have; parameters (23, LANES) rows of
    equations.ROWS; extras (12, LANES) parameters of the effect; inputs (8, n) as Inputs.pieces gives them, read where
    the record is driven (prescribed: the first is the acceleration of the primary, and channel 1 reads the torque that
    it takes, N m; swings: the fourth is that of a pendulum's pivot, m/s^2, in place of what the ground adds to
    readings); weights (LANES,) factor on the error tolerance; memory_weights (2,); longest_step: of a rig, s, an
    argument so that rigs of any pace share a kernel; read (3,) selects acceleration, velocity or displacement by a one
    among zeros; out (LANES, 2, n + 1) receives the readings (the last column is for what nobody reads), final (LANES,)
    a sum over the last state, which is finite if all of the record is, status (LANES,). Returns the number of steps
    that the slowest lane attempted.
    """
    # One array, so that LLVM sees that rows do not overlap; a width that it cannot know, so that it vectorises the
    # loop over lanes instead of unrolling it.
    block = np.zeros((BLOCK_ROWS, LANES))
    width = parameters.shape[1]
    clocks, n = times.shape
    end = float(n)
    read_acceleration = read[0]
    read_velocity = read[1]
    read_displacement = read[2]
    memory_weight1 = memory_weights[0]
    memory_weight2 = memory_weights[1]
    clock = np.empty(clocks * (n + 3))  # sample times, and more that make the intervals after the end empty
    for row in range(clocks):
        for i in range(n + 3):
            clock[row * (n + 3) + i] = times[row, min(i, n - 1)]
    apart = n + 3 if clocks > 1 else 0
    # Of torque1, torque2, the ground's and the pivot's acceleration: the largest value, and the range of the integral.
    most = np.zeros(4)
    swing = np.zeros(4)
    if driven():
        for row in range(4 if swings() else 3):
            total = 0.0
            low = 0.0
            high = 0.0
            for i in range(n):
                most[row] = max(most[row], abs(inputs[row, i]))
                gap = clock[i + 1] - clock[i]
                total += gap * (inputs[row, i] - 0.5 * gap * inputs[4 + row, i])
                low = min(low, total)
                high = max(high, total)
            swing[row] = high - low
    for lane in range(width):
        for row in range(EXTRA):
            block[row, lane] = parameters[row, lane]
        for row in range(4):
            block[EXTRA + row, lane] = extras[row, lane]
        for row in range(8):
            block[MORE + row, lane] = extras[4 + row, lane]
        j1 = block[J1, lane]
        j2 = block[J2, lane]
        j12 = block[J12, lane] if coupled() else 0.0
        block[J12, lane] = j12
        block[FRICTION, lane] = block[MU, lane] * block[N0, lane] * block[R_BAR, lane]
        determinant = j1 * j2 - j12 * j12
        block[MI11, lane] = j2 / determinant if coupled() else 1.0 / j1
        block[MI12, lane] = -j12 / determinant if coupled() else 0.0
        block[MI22, lane] = j1 / determinant if coupled() else 0.0
        block[SLOPE, lane] = block[R_BAR, lane] / (2.0 * block[R_FACE, lane]) if linear_normal_force() else 0.0
        omega = np.sqrt(abs(block[K1, lane]) / j1) + 1e-6
        angle = max(abs(block[THETA0, lane]), abs(block[TH20, lane]))
        speed = max(angle * omega, abs(block[W10, lane]), abs(block[W20, lane])) + 1e-9
        if driven():
            per_input = 1.0 if prescribed() else 1.0 / j1
            speed = max(speed, min(most[0] / omega, swing[0]) * per_input, min(most[2] / omega, swing[2]))
            speed = max(speed, min(most[1] / omega, swing[1]) / j2) if coupled() else speed
            speed = max(speed, min(most[3] / omega, swing[3]) * omega * omega * PER_GRAVITY) if swings() else speed
        block[EPS_W, lane] = 1e-8 * speed
        block[EPS_TH, lane] = 1e-8 * speed / omega
        allowed = weights[lane] * min(SPEED_TOLERANCE * speed, SWITCH_TOLERANCE / block[NU, lane])
        block[PER_SPEED, lane] = 1.0 / allowed
        block[PER_ACC1, lane] = 1.0 / (weights[lane] * ACCELERATION_TOLERANCE * speed * omega * j1)
        block[PER_ACC2, lane] = 1.0 / (weights[lane] * ACCELERATION_TOLERANCE * speed * omega * j2)
        block[TH1, lane] = block[THETA0, lane]
        block[TH2, lane] = block[TH20, lane]
        block[W1, lane] = block[W10, lane]
        block[W2, lane] = block[W20, lane]
        block[HELD1, lane] = read_displacement * block[THETA0, lane]
        block[HELD2, lane] = read_displacement * block[TH20, lane]
        slow = max(block[LETS_GO, lane], AT_ONCE)
        away = np.sin(block[THETA0, lane]) if pendulum() else block[THETA0, lane]
        block[HOLD, lane] = block[K1, lane] * away if slow > AT_ONCE else 0.0
        block[FALL, lane] = 1.0 / slow
        block[HTRY, lane] = 1e-5
        block[FIRST, lane] = 1.0
        if starts():
            rig = Rig(
                j1, j2, j12, block[K1, lane], block[K3, lane], block[C1, lane], block[C3, lane], block[K2, lane],
                block[C2, lane], block[MU, lane], block[N0, lane], block[R_BAR, lane], block[R_FACE, lane],
                block[DRAG, lane], block[NU, lane], block[TAIL, lane], block[THETA0, lane], block[SLOPE, lane],
            )  # fmt: skip
            p = (
                block[EXTRA, lane], block[EXTRA + 1, lane], block[EXTRA + 2, lane], block[EXTRA + 3, lane],
                block[MORE, lane], block[MORE + 1, lane], block[MORE + 2, lane], block[MORE + 3, lane],
                block[MORE + 4, lane], block[MORE + 5, lane], block[MORE + 6, lane], block[MORE + 7, lane],
            )  # fmt: skip
            block[Z1, lane], block[Z2, lane] = effect_start(p, rig)
        own = lane * apart
        now = max(clock[own] - block[DELAY, lane], 0.0)
        block[REST, lane] = max(clock[own + 1] - block[DELAY, lane], 0.0) - now
        block[NOW, lane] = clock[own]
        block[AFTER, lane] = clock[own + 1]
        block[NEXT, lane] = clock[own + 2]
        if driven():
            later = min(1, n - 1)
            block[DRIVE1, lane] = inputs[0, 0] - (j1 + j12) * inputs[2, 0]
            block[DRIVE2, lane] = inputs[1, 0] - (j2 + j12) * inputs[2, 0]
            block[SHOWN, lane] = inputs[3, 0]
            block[RAMP1, lane] = inputs[4, 0] - (j1 + j12) * inputs[6, 0]
            block[RAMP2, lane] = inputs[5, 0] - (j2 + j12) * inputs[6, 0]
            block[RISE, lane] = inputs[7, 0]
            block[DRIVE1_NEXT, lane] = inputs[0, later] - (j1 + j12) * inputs[2, later]
            block[DRIVE2_NEXT, lane] = inputs[1, later] - (j2 + j12) * inputs[2, later]
            block[SHOWN_NEXT, lane] = inputs[3, later]
            block[RAMP1_NEXT, lane] = inputs[4, later] - (j1 + j12) * inputs[6, later]
            block[RAMP2_NEXT, lane] = inputs[5, later] - (j2 + j12) * inputs[6, later]
            block[RISE_NEXT, lane] = inputs[7, later]

    live = width
    passes = 0
    while live > 0:
        live = 0
        passes += 1
        for lane in range(width):
            j1 = block[J1, lane]
            j2 = block[J2, lane]
            j12 = block[J12, lane]
            k1t = block[K1, lane]
            k3t = block[K3, lane]
            c1t = block[C1, lane]
            c3t = block[C3, lane]
            k2t = block[K2, lane]
            c2t = block[C2, lane]
            friction = 0.0 if frictionless() else block[FRICTION, lane]
            slope = block[SLOPE, lane]
            drag = block[DRAG, lane]
            drag2 = drag * block[DRAG_RATIO, lane]
            nu = block[NU, lane]
            tail = block[TAIL, lane]
            sharpness = TANH_SCALE * nu
            th1 = block[TH1, lane]
            th2 = block[TH2, lane]
            w1 = block[W1, lane]
            w2 = block[W2, lane]
            z1 = block[Z1, lane]
            z2 = block[Z2, lane]
            rest = block[REST, lane]
            t = block[TIME, lane]
            # As many equal steps as the proposed step size asks for, so that the last one lands on the sample.
            tries = max(rest / block[HTRY, lane] - 1e-9, 0.5)
            tries = (tries + 0.5 + 6755399441055744.0) - 6755399441055744.0
            h = rest / max(tries, 1.0)
            p = (
                block[EXTRA, lane], block[EXTRA + 1, lane], block[EXTRA + 2, lane], block[EXTRA + 3, lane],
                block[MORE, lane], block[MORE + 1, lane], block[MORE + 2, lane], block[MORE + 3, lane],
                block[MORE + 4, lane], block[MORE + 5, lane], block[MORE + 6, lane], block[MORE + 7, lane],
            )  # fmt: skip
            rig = Rig(
                j1, j2, j12, k1t, k3t, c1t, c3t, k2t, c2t, block[MU, lane], block[N0, lane], block[R_BAR, lane],
                block[R_FACE, lane], drag, nu, tail, block[THETA0, lane], slope,
            )  # fmt: skip

            # Stage 1: torques, Jacobian, and the reading of this instant.
            tau1, tau2, a1, a2, t_phi, b1, b2, t_slip = linearised(
                th1,
                th2,
                w1,
                w2,
                k1t,
                k3t,
                c1t,
                c3t,
                k2t,
                c2t,
                friction,
                slope,
                drag,
                drag2,
                nu,
                tail,
                curved(),
                coupled(),
                pendulum(),
            )
            hold = block[HOLD, lane]
            fall = block[FALL, lane]
            rate1 = 0.0
            rate2 = 0.0
            shown = 0.0
            left = 1.0 - (t + AT_ONCE) * fall
            tau1 = tau1 + hold * max(left, 0.0)
            moved = 0.0  # acceleration of a primary that is moved as prescribed
            if driven():
                rate1 = block[RAMP1, lane]
                moved = block[DRIVE1, lane] - rate1 * rest
                tau1 = tau1 + (0.0 if prescribed() else moved)
                shown = block[SHOWN, lane] - block[RISE, lane] * rest
                if coupled():
                    rate2 = block[RAMP2, lane]
                    tau2 = tau2 + (block[DRIVE2, lane] - rate2 * rest)
            rate1 = rate1 - (hold * fall if left > 0.0 else 0.0)
            q1 = 0.0
            q2 = 0.0
            f1 = 0.0
            f2 = 0.0
            grow1 = 0.0
            grow2 = 0.0
            # Jacobian of the torques: d_ij = d tau_i / d th_j, v_ij = d tau_i / d w_j, y_ij = d tau_i / d z_j;
            # and of the memory rates: x_ij by th, o_ij by w, g_ij by z.
            d11 = a1 - t_phi
            d12 = t_phi
            d21 = t_phi
            d22 = a2 - t_phi
            if swings():
                # A pivot that is moved sideways pulls at what hangs from it as gravity does, across.
                pushed = -PER_GRAVITY * shown
                pace = -PER_GRAVITY * block[RISE, lane]
                tau1 = tau1 + k1t * pushed * cos(th1)
                rate1 = rate1 + k1t * pace * cos(th1)
                d11 = d11 - k1t * pushed * sin(th1)
                if coupled():
                    tau2 = tau2 + k3t * pushed * cos(th2)
                    rate2 = rate2 + k3t * pace * cos(th2)
                    d22 = d22 - k3t * pushed * sin(th2)
                shown = 0.0
            v11 = b1 - t_slip
            v12 = t_slip
            v21 = t_slip
            v22 = b2 - t_slip
            if acts():
                q1, q2 = effect_torque(t, th1, th2, w1, w2, z1, z2, p, rig)
                eps = block[EPS_TH, lane]
                per = 1.0 / eps
                epw = block[EPS_W, lane]
                pew = 1.0 / epw
                if couples() == 0:
                    m1, m2 = effect_torque(t, th1 + eps, th2 + eps, w1, w2, z1, z2, p, rig)
                    n1, n2 = effect_torque(t, th1, th2, w1 + epw, w2 + epw, z1, z2, p, rig)
                    d11 = d11 + (m1 - q1) * per
                    d22 = d22 + (m2 - q2) * per
                    v11 = v11 + (n1 - q1) * pew
                    v22 = v22 + (n2 - q2) * pew
                elif couples() == 1:
                    m1, m2 = effect_torque(t, th1 + eps, th2, w1, w2, z1, z2, p, rig)
                    n1, n2 = effect_torque(t, th1, th2, w1 + epw, w2, z1, z2, p, rig)
                    across = (m1 - q1) * per
                    along = (n1 - q1) * pew
                    d11 = d11 + across
                    d12 = d12 - across
                    d21 = d21 - across
                    d22 = d22 + across
                    v11 = v11 + along
                    v12 = v12 - along
                    v21 = v21 - along
                    v22 = v22 + along
                else:
                    m1, m2 = effect_torque(t, th1 + eps, th2, w1, w2, z1, z2, p, rig)
                    n1, n2 = effect_torque(t, th1, th2, w1 + epw, w2, z1, z2, p, rig)
                    d11 = d11 + (m1 - q1) * per
                    d21 = d21 + (m2 - q2) * per
                    v11 = v11 + (n1 - q1) * pew
                    v21 = v21 + (n2 - q2) * pew
                    if coupled():
                        m1, m2 = effect_torque(t, th1, th2 + eps, w1, w2, z1, z2, p, rig)
                        n1, n2 = effect_torque(t, th1, th2, w1, w2 + epw, z1, z2, p, rig)
                        d12 = d12 + (m1 - q1) * per
                        d22 = d22 + (m2 - q2) * per
                        v12 = v12 + (n1 - q1) * pew
                        v22 = v22 + (n2 - q2) * pew
                if timed():
                    ept = 1e-8 * (eps / epw)
                    m1, m2 = effect_torque(t + ept, th1, th2, w1, w2, z1, z2, p, rig)
                    rate1 = rate1 + (m1 - q1) / ept
                    rate2 = rate2 + (m2 - q2) / ept
                tau1 = tau1 + q1
                tau2 = tau2 + q2

            y1 = read_acceleration * (block[MI11, lane] * tau1 + block[MI12, lane] * tau2)
            y2 = read_acceleration * (block[MI12, lane] * tau1 + block[MI22, lane] * tau2)
            y1 = y1 + read_velocity * w1 + read_displacement * th1
            y2 = y2 + read_velocity * w2 + read_displacement * th2
            j11 = j1
            j1x = j12
            if prescribed():
                carried = (tau2 - j12 * moved) * (1.0 / j2) if coupled() else 0.0
                y1 = j1 * moved + j12 * carried - tau1  # the reaction, N m
                y2 = read_acceleration * carried + read_velocity * w2 + read_displacement * th2
                # The first line of the equations becomes a1 = moved.
                j11 = 1.0
                j1x = 0.0
                tau1 = moved
                rate1 = block[RAMP1, lane]
                d11 = 0.0
                d12 = 0.0
                v11 = 0.0
                v12 = 0.0
            rest1 = block[HELD1, lane]
            rest2 = block[HELD2, lane]
            if driven():
                y1 = y1 + shown
                y2 = y2 + shown
                held_shown = block[SHOWN, lane] - block[RISE, lane] * (block[AFTER, lane] - block[NOW, lane])
                held_shown = 0.0 if swings() else held_shown
                rest1 = rest1 + held_shown
                rest2 = rest2 + held_shown
            if senses():
                # Everything is loaded before anything is chosen: a load that only one side needs would be a branch.
                first = block[FIRST, lane]
                u1 = block[U1, lane]
                u2 = block[U2, lane]
                old1 = block[S1, lane]
                old2 = block[S2, lane]
                past1 = block[V1, lane]
                past2 = block[V2, lane]
                oldest1 = block[R1, lane]
                oldest2 = block[R2, lane]
                delay = block[DELAY, lane]
                u1 = rest1 if first > 0.5 else u1
                u2 = rest2 if first > 0.5 else u2
                after = block[AFTER, lane]
                released = (rest > 0.0) or (after >= delay)
                since = block[HLAST, lane]
                m1, m2, s1, s2, v1, v2, r1, r2 = effect_sense(
                    since, u1, u2, y1, y2, old1, old2, past1, past2, oldest1, oldest2, p, first
                )
                held = block[NOW, lane] < delay
                # The sensors show a rig that is still held as they show everything: scaled, clipped, long settled.
                h1, h2, _, _, _, _, _, _ = effect_sense(
                    0.0, rest1, rest2, rest1, rest2, old1, old2, past1, past2, oldest1, oldest2, p, 1.0
                )
                block[Y1, lane] = h1 if held else m1
                block[Y2, lane] = h2 if held else m2
                block[S1, lane] = s1 if released else old1
                block[S2, lane] = s2 if released else old2
                block[V1, lane] = v1 if released else past1
                block[V2, lane] = v2 if released else past2
                block[R1, lane] = r1 if released else oldest1
                block[R2, lane] = r2 if released else oldest2
                block[U1, lane] = y1
                block[U2, lane] = y2
                block[FIRST, lane] = 0.0 if released else 1.0
            else:
                held = block[NOW, lane] < block[DELAY, lane]
                block[Y1, lane] = rest1 if held else y1
                block[Y2, lane] = rest2 if held else y2

            y11 = 0.0
            y12 = 0.0
            y21 = 0.0
            y22 = 0.0
            x11 = 0.0
            x12 = 0.0
            x21 = 0.0
            x22 = 0.0
            o11 = 0.0
            o12 = 0.0
            o21 = 0.0
            o22 = 0.0
            g11 = 0.0
            g12 = 0.0
            g21 = 0.0
            g22 = 0.0
            if memory() > 0:
                f1, f2 = effect_rate(t, th1, th2, w1, w2, z1, z2, p, rig)
                eps = block[EPS_TH, lane]
                per = 1.0 / eps
                epw = block[EPS_W, lane]
                pew = 1.0 / epw
                m1, m2 = effect_rate(t, th1 + eps, th2, w1, w2, z1, z2, p, rig)
                x11 = (m1 - f1) * per
                x21 = (m2 - f2) * per
                m1, m2 = effect_rate(t, th1, th2, w1 + epw, w2, z1, z2, p, rig)
                o11 = (m1 - f1) * pew
                o21 = (m2 - f2) * pew
                if coupled():
                    m1, m2 = effect_rate(t, th1, th2 + eps, w1, w2, z1, z2, p, rig)
                    x12 = (m1 - f1) * per
                    x22 = (m2 - f2) * per
                    m1, m2 = effect_rate(t, th1, th2, w1, w2 + epw, z1, z2, p, rig)
                    o12 = (m1 - f1) * pew
                    o22 = (m2 - f2) * pew
                epz = 1e-8 * memory_scale1()
                pez = 1.0 / epz
                m1, m2 = effect_rate(t, th1, th2, w1, w2, z1 + epz, z2, p, rig)
                g11 = (m1 - f1) * pez
                g21 = (m2 - f2) * pez
                if acts():
                    m1, m2 = effect_torque(t, th1, th2, w1, w2, z1 + epz, z2, p, rig)
                    y11 = (m1 - q1) * pez
                    y21 = (m2 - q2) * pez
                if memory() > 1:
                    epz = 1e-8 * memory_scale2()
                    pez = 1.0 / epz
                    m1, m2 = effect_rate(t, th1, th2, w1, w2, z1, z2 + epz, p, rig)
                    g12 = (m1 - f1) * pez
                    g22 = (m2 - f2) * pez
                    if acts():
                        m1, m2 = effect_torque(t, th1, th2, w1, w2, z1, z2 + epz, p, rig)
                        y12 = (m1 - q1) * pez
                        y22 = (m2 - q2) * pez
                if timed():
                    ept = 1e-8 * (eps / epw)
                    m1, m2 = effect_rate(t + ept, th1, th2, w1, w2, z1, z2, p, rig)
                    grow1 = (m1 - f1) / ept
                    grow2 = (m2 - f2) / ept

            if prescribed():
                y11 = 0.0
                y12 = 0.0

            # The matrix of all stages, after the angles (and the memory) are eliminated.
            gh = GAMMA * h
            gd11 = gh * d11
            gd12 = gh * d12
            gd21 = gh * d21
            gd22 = gh * d22
            s11 = j11 * (1.0 / GAMMA) - h * (v11 + gd11)
            s12 = 0.0
            s21 = 0.0
            s22 = 1.0
            if coupled():
                s12 = j1x * (1.0 / GAMMA) - h * (v12 + gd12)
                s21 = j12 * (1.0 / GAMMA) - h * (v21 + gd21)
                s22 = j2 * (1.0 / GAMMA) - h * (v22 + gd22)
            i11 = 0.0
            i12 = 0.0
            i21 = 0.0
            i22 = 0.0
            h11 = 0.0
            h12 = 0.0
            h21 = 0.0
            h22 = 0.0
            l11 = 0.0
            l12 = 0.0
            l21 = 0.0
            l22 = 0.0
            if memory() > 0:
                e11 = 1.0 / GAMMA - h * g11
                e22 = 1.0 / GAMMA - h * g22
                e12 = -h * g12
                e21 = -h * g21
                inverse = 1.0 / (e11 * e22 - e12 * e21)
                i11 = e22 * inverse
                i12 = -e12 * inverse
                i21 = -e21 * inverse
                i22 = e11 * inverse
                h11 = h * (o11 + gh * x11)
                h12 = h * (o12 + gh * x12)
                h21 = h * (o21 + gh * x21)
                h22 = h * (o22 + gh * x22)
                l11 = h * (y11 * i11 + y12 * i21)
                l12 = h * (y11 * i12 + y12 * i22)
                l21 = h * (y21 * i11 + y22 * i21)
                l22 = h * (y21 * i12 + y22 * i22)
                s11 = s11 - (l11 * h11 + l12 * h21)
                if coupled():
                    s12 = s12 - (l11 * h12 + l12 * h22)
                    s21 = s21 - (l21 * h11 + l22 * h21)
                    s22 = s22 - (l21 * h12 + l22 * h22)
            inverse = 1.0 / (s11 * s22 - s12 * s21)
            n11 = s22 * inverse
            n12 = -s12 * inverse
            n21 = -s21 * inverse
            n22 = s11 * inverse

            # Stage 1. p_i, r_i, m_i: increments of angle, velocity and memory; the index is stage then body.
            hw1 = h * w1
            hw2 = h * w2
            hh = h * h
            rhs1 = h * tau1 + (gd11 * hw1 + gd12 * hw2) + (hh * G1) * rate1
            rhs2 = h * tau2 + (gd21 * hw1 + gd22 * hw2) + (hh * G1) * rate2
            rz1 = 0.0
            rz2 = 0.0
            if memory() > 0:
                rz1 = h * f1 + gh * (x11 * hw1 + x12 * hw2) + (hh * G1) * grow1
                rz2 = h * f2 + gh * (x21 * hw1 + x22 * hw2) + (hh * G1) * grow2
                rhs1 = rhs1 + l11 * rz1 + l12 * rz2
                rhs2 = rhs2 + l21 * rz1 + l22 * rz2
            r11 = n11 * rhs1 + n12 * rhs2
            r12 = n21 * rhs1 + n22 * rhs2 if coupled() else 0.0
            p11 = gh * r11 + GAMMA * hw1
            p12 = gh * r12 + GAMMA * hw2
            m11 = 0.0
            m12 = 0.0
            if memory() > 0:
                rz1 = rz1 + h11 * r11 + h12 * r12
                rz2 = rz2 + h21 * r11 + h22 * r12
                m11 = i11 * rz1 + i12 * rz2
                m12 = i21 * rz1 + i22 * rz2

            # Stage 2.
            ath1 = th1 + A21 * p11
            ath2 = th2 + A21 * p12
            aw1 = w1 + A21 * r11
            aw2 = w2 + A21 * r12
            tau1, tau2 = smooth_torques(ath1, ath2, aw1, aw2, k1t, k3t, c1t, c3t, k2t, c2t, coupled(), pendulum())
            held1, held2 = friction_torques(
                ath1, ath2, aw1, aw2, friction, slope, drag, drag2, sharpness, tail, curved(), coupled()
            )
            tau1 = tau1 + hold * max(1.0 - (t + AT_ONCE + T2 * h) * fall, 0.0)
            if driven():
                tau1 = tau1 + (block[DRIVE1, lane] - block[RAMP1, lane] * (rest - T2 * h))
                if coupled():
                    tau2 = tau2 + (block[DRIVE2, lane] - block[RAMP2, lane] * (rest - T2 * h))
            if swings():
                pushed = PER_GRAVITY * (block[RISE, lane] * (rest - T2 * h) - block[SHOWN, lane])
                tau1 = tau1 + k1t * pushed * cos(ath1)
                tau2 = tau2 + k3t * pushed * cos(ath2) if coupled() else tau2
            if acts():
                q1, q2 = effect_torque(t + T2 * h, ath1, ath2, aw1, aw2, z1 + A21 * m11, z2 + A21 * m12, p, rig)
                tau1 = tau1 + q1
                tau2 = tau2 + q2
            if prescribed():
                tau1 = block[DRIVE1, lane] - block[RAMP1, lane] * (rest - T2 * h)
                held1 = 0.0
            c_1 = C21 * p11
            c_2 = C21 * p12
            e_1 = C21 * r11
            e_2 = C21 * r12
            hw1 = h * aw1 + c_1
            hw2 = h * aw2 + c_2
            rhs1 = h * tau1 + (j11 * e_1 + j1x * e_2) + (gd11 * hw1 + gd12 * hw2) + (hh * G2) * rate1 - h * held1
            rhs2 = h * tau2 + (j12 * e_1 + j2 * e_2) + (gd21 * hw1 + gd22 * hw2) + (hh * G2) * rate2 - h * held2
            if memory() > 0:
                f1, f2 = effect_rate(t + T2 * h, ath1, ath2, aw1, aw2, z1 + A21 * m11, z2 + A21 * m12, p, rig)
                rz1 = h * f1 + C21 * m11 + gh * (x11 * hw1 + x12 * hw2) + (hh * G2) * grow1
                rz2 = h * f2 + C21 * m12 + gh * (x21 * hw1 + x22 * hw2) + (hh * G2) * grow2
                rhs1 = rhs1 + l11 * rz1 + l12 * rz2
                rhs2 = rhs2 + l21 * rz1 + l22 * rz2
            r21 = n11 * rhs1 + n12 * rhs2
            r22 = n21 * rhs1 + n22 * rhs2 if coupled() else 0.0
            p21 = gh * r21 + GAMMA * hw1
            p22 = gh * r22 + GAMMA * hw2
            m21 = 0.0
            m22 = 0.0
            if memory() > 0:
                rz1 = rz1 + h11 * r21 + h12 * r22
                rz2 = rz2 + h21 * r21 + h22 * r22
                m21 = i11 * rz1 + i12 * rz2
                m22 = i21 * rz1 + i22 * rz2

            # Stage 3.
            ath1 = th1 + A31 * p11 + A32 * p21
            ath2 = th2 + A31 * p12 + A32 * p22
            aw1 = w1 + A31 * r11 + A32 * r21
            aw2 = w2 + A31 * r12 + A32 * r22
            az1 = z1 + A31 * m11 + A32 * m21
            az2 = z2 + A31 * m12 + A32 * m22
            tau1, tau2 = smooth_torques(ath1, ath2, aw1, aw2, k1t, k3t, c1t, c3t, k2t, c2t, coupled(), pendulum())
            held1, held2 = friction_torques(
                ath1, ath2, aw1, aw2, friction, slope, drag, drag2, sharpness, tail, curved(), coupled()
            )
            tau1 = tau1 + hold * max(1.0 - (t + AT_ONCE + T3 * h) * fall, 0.0)
            if driven():
                tau1 = tau1 + (block[DRIVE1, lane] - block[RAMP1, lane] * (rest - T3 * h))
                if coupled():
                    tau2 = tau2 + (block[DRIVE2, lane] - block[RAMP2, lane] * (rest - T3 * h))
            if swings():
                pushed = PER_GRAVITY * (block[RISE, lane] * (rest - T3 * h) - block[SHOWN, lane])
                tau1 = tau1 + k1t * pushed * cos(ath1)
                tau2 = tau2 + k3t * pushed * cos(ath2) if coupled() else tau2
            if acts():
                q1, q2 = effect_torque(t + T3 * h, ath1, ath2, aw1, aw2, az1, az2, p, rig)
                tau1 = tau1 + q1
                tau2 = tau2 + q2
            if prescribed():
                tau1 = block[DRIVE1, lane] - block[RAMP1, lane] * (rest - T3 * h)
                held1 = 0.0
            e_1 = C31 * r11 + C32 * r21
            e_2 = C31 * r12 + C32 * r22
            hw1 = h * aw1 + (C31 * p11 + C32 * p21)
            hw2 = h * aw2 + (C31 * p12 + C32 * p22)
            rhs1 = h * tau1 + (j11 * e_1 + j1x * e_2) + (gd11 * hw1 + gd12 * hw2) + (hh * G3) * rate1 - h * held1
            rhs2 = h * tau2 + (j12 * e_1 + j2 * e_2) + (gd21 * hw1 + gd22 * hw2) + (hh * G3) * rate2 - h * held2
            if memory() > 0:
                f1, f2 = effect_rate(t + T3 * h, ath1, ath2, aw1, aw2, az1, az2, p, rig)
                rz1 = h * f1 + (C31 * m11 + C32 * m21) + gh * (x11 * hw1 + x12 * hw2) + (hh * G3) * grow1
                rz2 = h * f2 + (C31 * m12 + C32 * m22) + gh * (x21 * hw1 + x22 * hw2) + (hh * G3) * grow2
                rhs1 = rhs1 + l11 * rz1 + l12 * rz2
                rhs2 = rhs2 + l21 * rz1 + l22 * rz2
            r31 = n11 * rhs1 + n12 * rhs2
            r32 = n21 * rhs1 + n22 * rhs2 if coupled() else 0.0
            p31 = gh * r31 + GAMMA * hw1
            p32 = gh * r32 + GAMMA * hw2
            m31 = 0.0
            m32 = 0.0
            if memory() > 0:
                rz1 = rz1 + h11 * r31 + h12 * r32
                rz2 = rz2 + h21 * r31 + h22 * r32
                m31 = i11 * rz1 + i12 * rz2
                m32 = i21 * rz1 + i22 * rz2

            # Stage 4: the torques are those of stage 3.
            e_1 = C41 * r11 + C42 * r21 + C43 * r31
            e_2 = C41 * r12 + C42 * r22 + C43 * r32
            hw1 = h * aw1 + (C41 * p11 + C42 * p21 + C43 * p31)
            hw2 = h * aw2 + (C41 * p12 + C42 * p22 + C43 * p32)
            rhs1 = h * tau1 + (j11 * e_1 + j1x * e_2) + (gd11 * hw1 + gd12 * hw2) + (hh * G4) * rate1 - h * held1
            rhs2 = h * tau2 + (j12 * e_1 + j2 * e_2) + (gd21 * hw1 + gd22 * hw2) + (hh * G4) * rate2 - h * held2
            if memory() > 0:
                rz1 = h * f1 + (C41 * m11 + C42 * m21 + C43 * m31) + gh * (x11 * hw1 + x12 * hw2)
                rz2 = h * f2 + (C41 * m12 + C42 * m22 + C43 * m32) + gh * (x21 * hw1 + x22 * hw2)
                rz1 = rz1 + (hh * G4) * grow1
                rz2 = rz2 + (hh * G4) * grow2
                rhs1 = rhs1 + l11 * rz1 + l12 * rz2
                rhs2 = rhs2 + l21 * rz1 + l22 * rz2
            r41 = n11 * rhs1 + n12 * rhs2
            r42 = n21 * rhs1 + n22 * rhs2 if coupled() else 0.0
            p41 = gh * r41 + GAMMA * hw1
            p42 = gh * r42 + GAMMA * hw2

            err1 = abs(E1 * r11 + E2 * r21 + E4 * r41)
            err2 = abs(E1 * r12 + E2 * r22 + E4 * r42)
            error = block[PER_SPEED, lane] * (err1 + err2)
            error = error + block[PER_ACC1, lane] * (abs(v11) * err1 + abs(v12) * err2)
            error = error + block[PER_ACC2, lane] * (abs(v21) * err1 + abs(v22) * err2)
            nz1 = z1
            nz2 = z2
            if memory() > 0:
                rz1 = rz1 + h11 * r41 + h12 * r42
                rz2 = rz2 + h21 * r41 + h22 * r42
                m41 = i11 * rz1 + i12 * rz2
                m42 = i21 * rz1 + i22 * rz2
                error = error + block[PER_SPEED, lane] * memory_weight1 * abs(E1 * m11 + E2 * m21 + E4 * m41)
                error = error + block[PER_SPEED, lane] * memory_weight2 * abs(E1 * m12 + E2 * m22 + E4 * m42)
                nz1 = z1 + B1 * m11 + B2 * m21 + B3 * m31 + B4 * m41
                nz2 = z2 + B1 * m12 + B2 * m22 + B3 * m32 + B4 * m42
            accepted = error <= 1.0
            factor = min(max(0.9 * fourth_root_of_inverse(max(error, 1e-8)), 0.2), 5.0)
            proposal = h * factor
            proposal = max(proposal, block[HTRY, lane]) if accepted and factor >= 1.0 else proposal
            block[HTRY, lane] = min(proposal, longest_step) if rest > 0.0 else block[HTRY, lane]
            block[TH1, lane] = th1 + B1 * p11 + B2 * p21 + B3 * p31 + B4 * p41 if accepted else th1
            block[W1, lane] = w1 + B1 * r11 + B2 * r21 + B3 * r31 + B4 * r41 if accepted else w1
            if coupled():
                block[TH2, lane] = th2 + B1 * p12 + B2 * p22 + B3 * p32 + B4 * p42 if accepted else th2
                block[W2, lane] = w2 + B1 * r12 + B2 * r22 + B3 * r32 + B4 * r42 if accepted else w2
            block[Z1, lane] = nz1 if accepted else z1
            block[Z2, lane] = nz2 if accepted else z2
            done = h if accepted else 0.0
            block[HLAST, lane] = done
            block[TIME, lane] = t + done
            rest = 0.0 if accepted and tries <= 1.0 else rest - done
            # Whoever has landed on a sample enters the next interval; lanes do not wait for each other.
            landed = rest <= 0.0
            attempts = block[ATTEMPTS, lane] + 1.0
            given_up = attempts >= MOST_PASSES
            sample = block[SAMPLE, lane]
            slot = sample if attempts < 1.5 else sample + 1.0  # what a later pass writes is overwritten
            sample = sample + 1.0 if landed else sample
            sample = end if given_up else min(sample, end)
            now = block[NOW, lane]
            after = block[AFTER, lane]
            coming = block[NEXT, lane]
            now = after if landed else now
            after = coming if landed else after
            delay = block[DELAY, lane]
            next_rest = max(after - delay, 0.0) - max(now - delay, 0.0)
            if driven():
                drive1 = block[DRIVE1, lane]
                drive2 = block[DRIVE2, lane]
                shown = block[SHOWN, lane]
                ramp1 = block[RAMP1, lane]
                ramp2 = block[RAMP2, lane]
                rise = block[RISE, lane]
                next_drive1 = block[DRIVE1_NEXT, lane]
                next_drive2 = block[DRIVE2_NEXT, lane]
                next_shown = block[SHOWN_NEXT, lane]
                next_ramp1 = block[RAMP1_NEXT, lane]
                next_ramp2 = block[RAMP2_NEXT, lane]
                next_rise = block[RISE_NEXT, lane]
                block[DRIVE1, lane] = next_drive1 if landed else drive1
                block[DRIVE2, lane] = next_drive2 if landed else drive2
                block[SHOWN, lane] = next_shown if landed else shown
                block[RAMP1, lane] = next_ramp1 if landed else ramp1
                block[RAMP2, lane] = next_ramp2 if landed else ramp2
                block[RISE, lane] = next_rise if landed else rise
            rest = next_rest if landed else rest
            block[REST, lane] = 0.0 if given_up else rest
            block[NOW, lane] = now
            block[AFTER, lane] = after
            block[SLOT, lane] = slot
            block[SAMPLE, lane] = sample
            block[ATTEMPTS, lane] = 0.0 if landed else attempts
            block[GIVEN_UP, lane] = max(block[GIVEN_UP, lane], 1.0 if given_up else 0.0)
            live += 1 if sample < end else 0
        # What LLVM would not vectorise. NEXT is needed a whole pass from now: a vector load that closely follows the
        # scalar stores it reads would have to wait for them.
        for lane in range(width):
            slot = int(block[SLOT, lane])
            out[lane, 0, slot] = block[Y1, lane]
            out[lane, 1, slot] = block[Y2, lane]
            i = int(block[SAMPLE, lane]) + 2
            block[NEXT, lane] = clock[lane * apart + i]
            if driven():
                k = min(i - 1, n - 1)
                moved1 = block[J1, lane] + block[J12, lane]
                moved2 = block[J2, lane] + block[J12, lane]
                block[DRIVE1_NEXT, lane] = inputs[0, k] - moved1 * inputs[2, k]
                block[DRIVE2_NEXT, lane] = inputs[1, k] - moved2 * inputs[2, k]
                block[SHOWN_NEXT, lane] = inputs[3, k]
                block[RAMP1_NEXT, lane] = inputs[4, k] - moved1 * inputs[6, k]
                block[RAMP2_NEXT, lane] = inputs[5, k] - moved2 * inputs[6, k]
                block[RISE_NEXT, lane] = inputs[7, k]
    for lane in range(width):
        final[lane] = block[TH1, lane] + block[TH2, lane] + block[W1, lane] + block[W2, lane] + block[Y1, lane]
        final[lane] += block[Y2, lane] + block[Z1, lane] + block[Z2, lane]
        status[lane] = STEP_UNDERFLOW if block[GIVEN_UP, lane] > 0.5 else COMPLETED
    return passes


def linked(times, parameters, extras, inputs, weights, memory_weights, longest_step, read, out, final, status):
    """`advance` with what `define` says: the source of every kernel."""
    define()
    return advance(times, parameters, extras, inputs, weights, memory_weights, longest_step, read, out, final, status)


@vector_math.lane
def define():
    """Nothing: what stands here in the plain functions of this module."""
