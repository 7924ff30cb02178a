"""The lights as the light kernels read them: which number stands in which column.

`stereorelight/light/shade.py` fills both tables, `light.py` takes their rows apart by kernel."""

from __future__ import annotations

# Columns of the light table, float32.
PLACE = 0  # 0..2: position, or the unit vector towards a directional light
IS_PLACE = 3  # 1 for a position, 0 for a direction
AXIS = 4  # 4..6: unit vector along which a spot shines
EDGE = 7  # angle off the axis at which a spot ends, radians
PER_ANGLE = 8  # 1 / penumbra in radians; 0 where the light is no spot
WRAP_SCALE, WRAP_OFFSET = 9, 10  # diffuse = max(0, scale N.L + offset)
FALL_NONE, FALL_LINEAR, FALL_SQUARE = 11, 12, 13  # strength = none + linear / d + square / d^2
WINDOW = 14  # 1 / radius^4 of the window (1 - d^4 / radius^4)^2; 0 for none
EXPONENT = 15
DIFFUSE, SPECULAR = 16, 19  # three channels each, everything that is the same for all pixels
# From here on only rows whose SHAPE or MODEL is not 0, or with a rim.
RADIUS = 22  # of a ball
SIDE_U, SIDE_V, HALF_U, HALF_V = 23, 26, 29, 30  # of a rectangle: unit vectors along its sides, and half their lengths; it shines along AXIS
ALPHA2, F0, IOR = 31, 32, 33  # of GGX: alpha^2; reflectance head on; index for the exact Fresnel formula, 0 for Schlick's
RIM, RIM_POWER = 34, 37  # three channels of (1 - N.V)^power
COLUMNS = 38
# Columns of the integer table: which mattes, and which output layers, -1 for none; and what kind of row it is.
MATTE, DIFFUSE_SLOT, SPECULAR_SLOT, COVER, SHAPE, MODEL, ADDS, GLOW = range(8)
SLOTS = 8
POINT, BALL, RECTANGLE = 0, 1, 2  # SHAPE
PHONG, GGX = 0, 1  # MODEL
# COVER is a second matte, a material's; a row that ADDS goes on top of the layers of the row before it, which is the same light on
# another material; GLOW is its row of the GGX tables.

MOST_SQUARED = 127  # whole exponents up to here are raised by squaring; beyond, rounding would add up to 1e-5
STRIP = 2048  # pixels of a row that go through all steps together; its rows stay in the second-level cache
PADDING = 80  # rows a whole page apart would fall onto the same cache lines
VECTOR = 64  # whole vectors, unrolled, on any machine of today
