"""What neighbouring frames say of a pixel's depth, carried along the motion and weighed against each other.

In: inverse depth of a frame and of its neighbours, (H, W) float32 in one unit, NaN where unknown, with standard deviations
in the same unit; motion (h, w, 2) px.  Out: arrays of the frame's size.  A pixel's result depends on its inputs alone:
the same bits come whatever the number of threads.

A value has a kind, two bits: BELIEVED, both eyes saw it, no guess; FIRM, its motion is the same all around, so that it
cannot be a neighbouring surface's."""

from __future__ import annotations

import numpy as np
from numba import njit

from stereorelight.arrays import Bool, Float32, UInt8
from stereorelight.engine.rows import in_row_blocks

f4 = np.float32
BELIEVED, FIRM = 1, 2
MOST = 9  # frames of the widest window


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bilinear(field, u, v, c):
    """Component c of a (H, W, 2) field at (u, v), the border repeated."""
    H, W = field.shape[0], field.shape[1]
    u, v = min(max(u, f4(0)), f4(W - 1)), min(max(v, f4(0)), f4(H - 1))
    i, j = min(int(u), max(W - 2, 0)), min(int(v), max(H - 2, 0))
    a, b = u - f4(i), v - f4(j)
    i1, j1 = min(i + 1, W - 1), min(j + 1, H - 1)
    top = (f4(1) - a) * field[j, i, c] + a * field[j, i1, c]
    return (f4(1) - b) * top + b * ((f4(1) - a) * field[j1, i, c] + a * field[j1, i1, c])


@njit(cache=True, nogil=True, error_model="numpy")
def _astray(first, end, there, back, out):
    H, W = out.shape
    for y in range(first, end):
        for x in range(W):
            u, v = f4(x) + there[y, x, 0], f4(y) + there[y, x, 1]
            if not (u >= f4(-0.5) and v >= f4(-0.5) and u <= f4(W - 0.5) and v <= f4(H - 0.5)):
                out[y, x] = np.inf
                continue
            du, dv = there[y, x, 0] + _bilinear(back, u, v, 0), there[y, x, 1] + _bilinear(back, u, v, 1)
            out[y, x] = np.sqrt(du * du + dv * dv)


def there_and_back(there: Float32, back: Float32) -> Float32:
    """(h, w) px by which the way there and back misses its start; infinite where the way there leaves the frame."""
    out = np.empty(there.shape[:2], np.float32)
    in_row_blocks(lambda first, end: _astray(first, end, there, back, out), there.shape[0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _carried(first, end, value, sigma, sure, believed, there, astray, bent, limit, apart, out_value, out_sigma, out_sure, out_kind):
    H, W = value.shape
    h, w = astray.shape
    sx, sy = f4(w) / f4(W), f4(h) / f4(H)
    for y in range(first, end):
        for x in range(W):
            out_value[y, x], out_sigma[y, x], out_sure[y, x], out_kind[y, x] = np.nan, np.nan, f4(0), 0
            p, q = (f4(x) + f4(0.5)) * sx - f4(0.5), (f4(y) + f4(0.5)) * sy - f4(0.5)
            i, j = min(max(int(np.floor(p + f4(0.5))), 0), w - 1), min(max(int(np.floor(q + f4(0.5))), 0), h - 1)
            if not astray[j, i] <= limit:
                continue
            u, v = f4(x) + _bilinear(there, p, q, 0) / sx, f4(y) + _bilinear(there, p, q, 1) / sy
            if not (u >= f4(-0.5) and v >= f4(-0.5) and u < f4(W - 0.5) and v < f4(H - 0.5)):
                continue
            xn, yn = min(int(np.floor(u + f4(0.5))), W - 1), min(int(np.floor(v + f4(0.5))), H - 1)
            here = value[yn, xn]
            if here != here:
                continue
            x0, y0 = min(max(int(np.floor(u)), 0), max(W - 2, 0)), min(max(int(np.floor(v)), 0), max(H - 2, 0))
            total, weight, steep = f4(0), f4(0), f4(0)
            for b in range(min(2, H)):
                for a in range(min(2, W)):
                    d = value[y0 + b, x0 + a]
                    if abs(d - here) < apart:  # false for NaN
                        k = max(f4(1) - abs(u - f4(x0 + a)), f4(0)) * max(f4(1) - abs(v - f4(y0 + b)), f4(0))
                        total += k * d
                        weight += k
                        steep = max(steep, abs(d - here))
            out_value[y, x] = total / weight if weight > f4(0) else here
            # A motion that is off by so much reads the depth of a place so far away.
            off = steep * astray[j, i] / sx
            out_sigma[y, x] = np.sqrt(sigma[yn, xn] * sigma[yn, xn] + off * off)
            out_sure[y, x] = sure[yn, xn]
            out_kind[y, x] = (BELIEVED if believed[yn, xn] else 0) + (0 if bent[j, i] else FIRM)


def carry_into(
    out: tuple[Float32, Float32, Float32, UInt8],
    value: Float32,
    sigma: Float32,
    sure: Float32,
    believed: Bool,
    there: Float32,
    astray: Float32,
    bent: Bool,
    *,
    limit: float,
    apart: float,
) -> None:
    """Fill `out`: a neighbour's value, sigma and confidence where the motion says that each pixel has gone, and their kind.

    NaN where a pixel has gone nowhere.  It writes in place, since a window of large frames is held at once.

    there  : (h, w, 2) px of its own grid, which may be coarser than the frame.   astray : (h, w) its error there and back, px.
    bent   : (h, w), another motion is near.                                      limit  : of `astray`, beyond which nothing is carried.
    apart  : values farther apart are two surfaces, never mixed.
    """
    given = (value, sigma, sure, believed, there, astray, bent, f4(limit), f4(apart), *out)
    in_row_blocks(lambda first, end: _carried(first, end, *given), value.shape[0])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sort(a, n):
    for i in range(1, n):
        v = a[i]
        j = i - 1
        while j >= 0 and a[j] > v:
            a[j + 1] = a[j]
            j -= 1
        a[j + 1] = v


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _middle(a, n):
    """Median of n sorted values."""
    return a[n // 2] if n % 2 == 1 else f4(0.5) * (a[n // 2] + a[n // 2 - 1])


@njit(cache=True, nogil=True, error_model="numpy")
def _rates(first, end, values, kind, times, rate, weight):
    n, _, W = values.shape
    slopes = np.empty(MOST * (MOST - 1) // 2, np.float32)
    for y in range(first, end):
        for x in range(W):
            m = 0
            for i in range(n):
                a = values[i, y, x]
                if a == a and kind[i, y, x] & BELIEVED:
                    for j in range(i + 1, n):
                        b = values[j, y, x]
                        if b == b and kind[j, y, x] & BELIEVED:
                            slopes[m] = (b - a) / (times[j] - times[i])
                            m += 1
            rate[y, x], weight[y, x] = f4(0), f4(0)
            if m > 0:
                _sort(slopes, m)
                rate[y, x] = _middle(slopes, m)
                weight[y, x] = f4(m) / f4(n * (n - 1) // 2)


def rates(values: Float32, kind: UInt8, times: Float32) -> tuple[Float32, Float32]:
    """(H, W) by how much the values (n, H, W) grow a frame, and its weight 0..1: the median over all pairs of frames (Theil, Sen)."""
    out = (np.empty(values.shape[1:], np.float32), np.empty(values.shape[1:], np.float32))
    in_row_blocks(lambda first, end: _rates(first, end, values, kind, times, *out), values.shape[1])
    return out


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _ranked(v, g, kind, wanted, own, order, ranked):
    """Sort the values whose kind has all the bits `wanted`, with their shares; how many they are, and their shares in all."""
    m, total = 0, f4(0)
    for i in range(v.size):
        if g[i] > f4(0) and kind[i] & wanted == wanted:
            k = g[i] * own if i == 0 else g[i]
            j = m - 1
            while j >= 0 and order[j] > v[i]:
                order[j + 1], ranked[j + 1] = order[j], ranked[j]
                j -= 1
            order[j + 1], ranked[j + 1] = v[i], k
            m += 1
            total += k
    return m, total


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _elected(order, ranked, m, total):
    """The weighted median of m ranked values."""
    sofar = f4(0)
    for j in range(m):
        sofar += ranked[j]
        if sofar >= f4(0.5) * total:
            return order[j]
    return order[m - 1]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _surface(v, g, kind, own, near, order, ranked):
    """The value that most of the evidence speaks for, whether anybody saw it, and how far the evidence scatters about it."""
    believed = kind[0] & BELIEVED != 0 and g[0] > f4(0)
    middle = v[0]
    m, total = _ranked(v, g, kind, BELIEVED | FIRM, own, order, ranked)
    if m > 0:
        pick = _elected(order, ranked, m, total)
        if not believed:  # a guess gives way to those that saw, where they agree, and stands by them where it agrees
            count = 0
            for j in range(m):
                if abs(order[j] - pick) < near:
                    count += 1
            believed = abs(pick - middle) < near or (count > 1 and 2 * count > m)
        if believed:
            middle = pick
    if not believed:
        m, total = _ranked(v, g, kind, FIRM, own, order, ranked)
        if m > 0 and middle == middle:
            middle = _elected(order, ranked, m, total)
    scatter = f4(0)
    if m > 2:
        for j in range(m):
            order[j] = abs(order[j] - middle)
        _sort(order, m)
        scatter = _middle(order, m)
    return middle, believed, scatter


@njit(cache=True, nogil=True, error_model="numpy")
def _combined(first, end, values, sigmas, sures, kind, times, shares, rate, own, alike, near, wide, wild, out_value, out_sigma, out_sure, out_seen):
    n, _, W = values.shape
    v, s, g, gate = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    order, ranked = np.empty(n, np.float32), np.empty(n, np.float32)
    for y in range(first, end):
        for x in range(W):
            out_value[y, x], out_sigma[y, x], out_sure[y, x], out_seen[y, x] = np.nan, np.nan, f4(0), False
            for i in range(n):
                v[i], s[i] = values[i, y, x] - rate[y, x] * times[i], sigmas[i, y, x]
                g[i] = shares[i] if v[i] == v[i] else f4(0)
            middle, believed, scatter = _surface(v, g, kind[:, y, x], own, near, order, ranked)
            if middle != middle:
                continue
            for i in range(n):
                gate[i] = min(max(f4(3) * s[i], near, f4(4.5) * scatter), wide if believed else wild)
            weight, sure, once, twice, saw = f4(0), f4(0), f4(0), f4(0), f4(0)
            for _ in range(3):
                weight, sure, once, twice, saw, moved = f4(0), f4(0), f4(0), f4(0), f4(0), f4(0)
                for i in range(n):
                    if g[i] > f4(0):
                        e = (v[i] - middle) / gate[i]
                        k = f4(1) - e * e
                        if k > f4(0):
                            # By 1/sigma, not its square: half of what sigmas of one surface differ by is chance, and weights that
                            # change from frame to frame by chance flicker.
                            k = g[i] * k * k / s[i]
                            weight += k
                            moved += k * (v[i] - middle)
                            sure += k * sures[i, y, x]
                            once += k * s[i]
                            twice += k * s[i] * k * s[i]
                            saw += k if kind[i, y, x] & BELIEVED else f4(0)
                middle += moved / weight if weight > f4(0) else f4(0)
            if weight > f4(0):
                out_value[y, x], out_sure[y, x] = middle, sure / weight
                out_sigma[y, x] = np.sqrt((f4(1) - alike) * twice + alike * once * once) / weight
                out_seen[y, x] = saw > f4(0.5) * weight


def combined(
    values: Float32,
    sigmas: Float32,
    sures: Float32,
    kind: UInt8,
    times: Float32,
    shares: Float32,
    rate: Float32,
    *,
    own: float,
    alike: float,
    near: float,
    wide: float,
    wild: float,
) -> tuple[Float32, Float32, Float32, Bool]:
    """One value a pixel from (n, H, W) of several frames, the frame's own first: value, sigma, confidence, and whether it was seen.

    times      : (n,) frames from the frame itself.    shares : (n,) what each counts beside its 1/sigma.
    rate       : (H, W) by how much the values grow a frame.
    own        : how many times its share the frame's own value counts in the vote on which surface it is.
    alike      : correlation of the errors of two frames.
    near, wide : least and largest distance from the vote at which a value stops counting; between them, three of its sigmas or
                 3 robust standard deviations of what is there.
    wild       : largest distance where there are guesses alone.
    """
    size = values.shape[1:]
    out = (np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.bool_))
    given = (values, sigmas, sures, kind, times, shares, rate, f4(own), f4(alike), f4(near), f4(wide), f4(wild), *out)
    in_row_blocks(lambda first, end: _combined(first, end, *given), size[0])
    return out
