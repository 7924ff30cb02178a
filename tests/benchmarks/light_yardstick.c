// The light kernel's job by hand, to measure it against: point, directional and spot lights, Lambert and Phong, inverse square.
// gcc -O3 -march=native -ffast-math -fopenmp -shared -fPIC; rows as separate arrays, so that the inner loops become vector code.
#include <math.h>
#include <stdint.h>
#include <stddef.h>
#define WIDEST 8192

static inline float log2_of(float x) {
  union { float f; int32_t i; } u = {x};
  int32_t e = (u.i - 0x3f3504f3) >> 23;
  u.i -= e << 23;
  float s = (u.f - 1.f) / (u.f + 1.f), q = s * s;
  return s * (2.885390082f + q * (0.961796694f + q * (0.577078016f + q * (0.412198583f + q * 0.320598898f)))) + (float)e;
}

static inline float exp2_of(float x) {
  x = x < -126.f ? -126.f : x;
  float r = __builtin_floorf(x + .5f), f = x - r;
  float p = 1.f + f * (0.693147181f + f * (0.240226507f + f * (0.0555041087f + f * (0.00961812911f + f * (0.00133335581f + f * 0.000154035304f)))));
  union { float f; int32_t i; } u;
  u.i = ((int32_t)r + 127) << 23;
  return p * u.f;
}

// x^(2^k ...) by squaring, for a whole exponent that is the same for all pixels.
static inline float squared_up(float x, int n) {
  float p = 1.f;
  while (n) {
    if (n & 1) p *= x;
    x *= x;
    n >>= 1;
  }
  return p;
}

// Lights: 12 floats each: place x y z (scene frame), w (1 place, 0 direction); spot axis x y z, scale, offset; r g b.
void relight(const float *restrict Z, const float *restrict N, const float *restrict A, float *restrict O, int H, int W, const float *L, int lights,
             float fx, float fy, float cx, float cy, float ks, float exponent) {
  const float per_fx = 1.f / fx, per_fy = 1.f / fy;
  const int whole = exponent == (int)exponent && exponent <= 128 ? (int)exponent : 0;
#pragma omp parallel for schedule(dynamic, 8)
  for (int y = 0; y < H; y++) {
    float px[WIDEST], py[WIDEST], pz[WIDEST], nx[WIDEST], ny[WIDEST], nz[WIDEST], vx[WIDEST], vy[WIDEST], vz[WIDEST];
    float dr[WIDEST], dg[WIDEST], db[WIDEST], sr[WIDEST], sg[WIDEST], sb[WIDEST];
    const float *z = Z + (size_t)y * W, *n = N + (size_t)3 * y * W, *a_ = A + (size_t)3 * y * W;
    float *o = O + (size_t)3 * y * W, slope = -(y - cy) * per_fy;
#pragma GCC ivdep
    for (int x = 0; x < W; x++) {
      float d = z[x], a = (x - cx) * per_fx * d, b = slope * d, r = -1.f / sqrtf(a * a + b * b + d * d);
      px[x] = a; py[x] = b; pz[x] = -d;
      vx[x] = a * r; vy[x] = b * r; vz[x] = -d * r;
      nx[x] = n[3 * x]; ny[x] = n[3 * x + 1]; nz[x] = n[3 * x + 2];
      dr[x] = dg[x] = db[x] = sr[x] = sg[x] = sb[x] = 0.f;
    }
    for (int k = 0; k < lights; k++) {
      const float *l = L + 12 * k;
      const float lx = l[0], ly = l[1], lz = l[2], w = l[3], ex = l[4], ey = l[5], ez = l[6], scale = l[7], offset = l[8], cr = l[9], cg = l[10], cb = l[11];
#define LIT(POWER) \
      _Pragma("GCC ivdep") for (int x = 0; x < W; x++) { \
        float a = lx - w * px[x], b = ly - w * py[x], c = lz - w * pz[x], d2 = a * a + b * b + c * c, r = 1.f / sqrtf(d2); \
        a *= r; b *= r; c *= r; \
        float t = offset - (a * ex + b * ey + c * ez) * scale; \
        t = t < 0 ? 0 : t; \
        t = t > 1 ? 1 : t; \
        float strength = r * r * t * t * (3.f - 2.f * t), nl = nx[x] * a + ny[x] * b + nz[x] * c, front = nl > 0 ? nl : 0.f; \
        float nv = nx[x] * vx[x] + ny[x] * vy[x] + nz[x] * vz[x], rv = 2.f * front * nv - (a * vx[x] + b * vy[x] + c * vz[x]); \
        rv = rv < 1e-20f ? 1e-20f : rv; \
        float s = nl > 0 ? POWER * strength * ks : 0.f, e = front * strength; \
        dr[x] += e * cr; dg[x] += e * cg; db[x] += e * cb; \
        sr[x] += s * cr; sg[x] += s * cg; sb[x] += s * cb; \
      }
      if (whole == 32) { float q; LIT((q = rv * rv, q *= q, q *= q, q *= q, q * q)) }
      else if (whole) { LIT(squared_up(rv, whole)) }
      else { LIT(exp2_of(exponent * log2_of(rv))) }
    }
#pragma GCC ivdep
    for (int x = 0; x < W; x++) {
      o[3 * x] = a_[3 * x] + a_[3 * x] * dr[x] + sr[x];
      o[3 * x + 1] = a_[3 * x + 1] + a_[3 * x + 1] * dg[x] + sg[x];
      o[3 * x + 2] = a_[3 * x + 2] + a_[3 * x + 2] * db[x] + sb[x];
    }
  }
}
